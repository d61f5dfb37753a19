"""Checks before a run: wiring and scales, and the flip test of the accelerometer.

Other rooms take `check`, `flip_test`.
"""
