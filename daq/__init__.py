"""Data acquisition: everything that keeps, checks and reads what was measured; knows neither rig nor analysis.

Other rooms take `lock_in`.
"""
