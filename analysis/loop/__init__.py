"""The closed loop: from recordings to a verdict with everything it rests on, and the run to make next.

Other rooms take `close_loop`, `result`, `storage`, `verdict`, `verdict_json` and `design`.
"""
