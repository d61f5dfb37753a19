"""Benchmarks of the run: interlock, closed loop, losses, virtual devices."""
