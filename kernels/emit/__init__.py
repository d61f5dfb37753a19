"""Code of the intrinsics: imported by what compiles, after numba."""
