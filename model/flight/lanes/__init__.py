"""Flights side by side: one a lane, in as many lanes as a processor computes at once.

Other rooms take `edge_table`, `ideal_lanes`, `friction_lanes`.
"""
