"""Every effect that may be added to the ideal ball: one file an effect; adding one edits nothing else.

Other rooms take `registry` (an effect by its name, rows of parameters, where declared effects act) and `base` (what an
effect is made of).
"""
