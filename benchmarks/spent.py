"""What a process used: processor seconds and memory, as the operating system tells them.

Windows tells neither: memory is NaN there, and `processor_seconds` needs Linux or macOS.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def peak_mb() -> float:
    """Most memory that this process has had so far, MB; NaN on Windows."""
    try:
        import resource
    except ImportError:
        return float("nan")
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024.0 if sys.platform != "darwin" else 1024.0**2)


def processor_seconds(code: str, arguments: list[str], tree: Path, folder: Path) -> tuple[float, float]:
    """Processor seconds of all threads, and wall seconds, of a Python process that runs ``code``.

    Parameters
    ----------
    code, arguments
        As after ``python -c``.
    tree
        The software it runs.
    folder
        Where it runs, and keeps its kernels.
    """
    environment = os.environ | {"PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(folder)}
    with tempfile.TemporaryFile() as out:
        began = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-c", code, *arguments], cwd=folder, env=environment, stdout=out, stderr=out
        )
        _, status, used = os.wait4(process.pid, 0)  # POSIX only: the children's times, one by one
        wall = time.perf_counter() - began
        if status:
            out.seek(0)
            raise SystemExit(f"python -c ... {' '.join(arguments)} failed with {tree}:\n{out.read().decode()}")
    return used.ru_utime + used.ru_stime, wall
