"""The simulated rig: plant, sensors and scenarios with physics of their own; only drive samples reach it.

Other rooms take `scenario`, `plant`.
"""
