"""Properties of a recording's instruments, measured from it, and contradictions to its profile.

Other rooms take `instrument_of` and `refuse_doubtful` (`stored.py`), and `examine` (`measure.py`).
"""
