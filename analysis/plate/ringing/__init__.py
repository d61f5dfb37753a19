"""A plate mode that rings: found in a recording, and its motion, from what the ball does to the plate.

Other rooms take `modes` and `mode_motion`.
"""
