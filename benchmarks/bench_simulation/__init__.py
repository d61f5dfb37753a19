"""The whole bench in one process, from one seed: product code under a virtual clock, on a disk that can fail.

`python -m benchmarks.bench_simulation --help`; what was run and found: docs/results/trust.md.
"""
