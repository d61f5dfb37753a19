"""Trials of the closed loop on sealed recordings, and the tables that come of them."""
