"""The work behind the commands: runs, calibrations, reprocessing, drop tests.

Other packages take `loops`, `run_ramp`, `drop_test`.
"""
