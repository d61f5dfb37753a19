"""Setup of a measurement: channels, scales, forcing; strict TOML; the age of calibrations.

Other rooms take `setup`, `values`, `errors`, `clock`, `provenance`.
"""
