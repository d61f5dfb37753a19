"""Recordings for other readers: CSV, NPZ, plain HDF5, Parquet, NetCDF, MATLAB, UFF58, TDMS; another sample rate.

Other rooms take `export`, `resample`.
"""
