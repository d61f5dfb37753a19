"""Accelerometer and drive to the plate's motion in each step, with covariance.

Other rooms take `accumulator`, `motion`, `fit_mask`, `mains_lines`, and `multiples_of` of `step_state`.
"""
