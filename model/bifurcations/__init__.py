"""Where the motion changes as gamma grows.

Other rooms take `events`, `sweep`, `continuation`, `forbidden_zones`.
"""
