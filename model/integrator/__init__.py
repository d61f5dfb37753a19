"""Flights with any set of effects, numerically, in SI units.

Other rooms take `one_step`, `flight`, `takeoff`.
"""
