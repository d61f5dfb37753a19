"""Properties of a recording's instruments, measured from it, and contradictions to its profile.

Other rooms take `instrument`, `measure` and `channel_limits`.
"""
