"""Profiles of rigs: found by name, planned, edited in place, improved, and turned into the next run's.

Other packages take `find`, `edit` and `improved`.
"""
