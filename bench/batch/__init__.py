"""Many recordings at once: each examined by itself, results stored as they come in, one table at the end.

Other rooms take `examine` and `run_batch`.
"""
