"""Benchmarks of recording, importing and clocks."""
