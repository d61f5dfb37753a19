"""Recordings for other readers: CSV, NPZ, plain HDF5, another sample rate.

Other rooms take `export`, `resample`.
"""
