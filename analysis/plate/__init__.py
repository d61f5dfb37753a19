"""Accelerometer and drive to the plate's motion in each step, with covariance.

Other rooms take `accumulator`, `motion`, `mains_lines` and `step_state`.
"""
