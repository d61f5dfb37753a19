"""Freed arrays leave their memory to the next."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

MAKE_ARRAYS = """
import resource
import numpy as np
{first}
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
def results():
    return [np.ones(1 << 17) for _ in range(4)]  # 1 MiB each
results()
before = faults()
for _ in range(20):
    results()
print(faults() - before)
"""


def _faults(first: str) -> int:
    """Pages that the system had to give to arrays of 4 MiB, made and dropped twenty times in a process of its own."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith("MALLOC_")}
    command = [sys.executable, "-c", MAKE_ARRAYS.format(first=first)]
    return int(subprocess.run(command, check=True, capture_output=True, text=True, env=plain).stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries have rules of their own")
def test_results_need_no_new_pages_where_there_were_results_before() -> None:
    """Once kernels are imported, arrays take the pages of those before them, which the system else gives anew."""
    assert _faults("from kernels import njit") < _faults("") / 10
