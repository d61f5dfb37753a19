"""Benchmarks: as in `bench`, linear algebra has one thread where nothing else is said, their child processes' too."""

import os

from kernels import BLAS_THREADS

for _name in BLAS_THREADS:
    os.environ.setdefault(_name, "1")
