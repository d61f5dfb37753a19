"""The whole bench under virtual time: no seed breaks what must hold, and an error put into the product is found."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PLANS = Path(__file__).with_name("simulated_plans.txt")

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or shutil.which("cc") is None, reason="the simulated disk needs Linux and a C compiler"
)


def simulate(*arguments: str) -> subprocess.CompletedProcess[str]:
    """The benchmark, with what it said."""
    command = [sys.executable, "-m", "benchmarks.bench_simulation", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[2], check=False)
    assert "ctypes callback" not in done.stderr, done.stderr  # an error of the simulated disk itself is only printed
    return done


def test_no_seed_breaks_anything() -> None:
    """Seeds that no one chose: drive, samples, counts and words are right, and the same seed gives the same bytes."""
    done = simulate("--seeds", "0:24")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "24 runs, 0 broke something" in done.stdout


def test_what_was_mended_stays_so() -> None:
    """Plans that once broke something, each of which says what it was."""
    done = simulate("--plans", str(PLANS))
    assert done.returncode == 0, done.stdout + done.stderr


QUICK, SLOW = "last sample not limited", ("ring overwrites", "ring not emptied", "no checksum of samples")


@pytest.mark.parametrize("mutant", [QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
def test_an_error_in_the_product_is_found(mutant: str) -> None:
    """An error put into the product, such as a drive beyond its limit for one sample, is found by some plan or seed."""
    plans = [] if mutant == QUICK else ["--plans", str(PLANS)]
    done = simulate("--mutant", mutant, *plans, "--seeds", "0:1500", "--most", "1", "--twice", "0")
    assert done.returncode == 1 and "seed " in done.stdout
