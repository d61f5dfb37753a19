"""Where the motion changes as gamma grows.

Other rooms take `find`, `events`, `sweep`, `forbidden_zones`, `cycle_branches`.
"""
