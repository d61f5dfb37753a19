"""Benchmarks of the command line and the pages."""
