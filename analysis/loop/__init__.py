"""The closed loop: from recordings to a verdict with everything it rests on, and the run to make next.

Other rooms take `close_loop`, `result`, `verdict`, `tables` and `design`.
"""
