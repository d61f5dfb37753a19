"""What the instruments of a recording are, measured from it, and where that contradicts its profile.

Other rooms take `instrument_of` and `refuse_doubtful` (`stored.py`), and `examine` (`measure.py`).
"""
