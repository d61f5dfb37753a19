"""Steps of a ramp, found in a recorded drive or acceleration.

Other rooms take `find_steps`, `forcing_detection`.
"""
