"""The execution of a run: drive out, frames in, limits, closed loop, losses.

Other rooms take `run`, `priority`, `plate_monitor`.
"""
