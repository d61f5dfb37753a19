"""Test doubles: faults, a serial device in this process, a stand-in for NI's driver. No command reaches them.

Other rooms take `faults`, `serial_loopback`, `fake_nidaqmx` in tests and benchmarks only.
"""
