"""An environment of the tests' own; the plant behind a real audio driver; a closed loop made of plain numbers."""

from __future__ import annotations

import atexit
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

if TYPE_CHECKING:
    from analysis.loop.result import ClosedLoop
    from rig.profile import Profile

ROOT = Path(__file__).resolve().parents[1]
NEEDED = ("PATH", "BOUNCE_DATA", "CI", "USER", "USERNAME", "LOGNAME", "COMSPEC", "PATHEXT", "NUMBER_OF_PROCESSORS")
NEEDED += ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
NEEDED_BEGINNINGS = ("PYTEST_", "PLAYWRIGHT_", "LD_LIBRARY_", "DYLD_", "SYSTEM", "WINDIR", "PROGRAMFILES")


def _isolate() -> None:
    """Leave of the environment what a system needs; home, caches, effects and temporary files are the tests' own.

    Called before anything of the project is imported: some of it reads the environment when it is. Compiled kernels and
    matplotlib's fonts stay in the checkout, where the next run of the tests finds them.
    """
    machine = tempfile.gettempdir()
    given = {
        name: value
        for name, value in os.environ.items()
        if name.upper() in NEEDED or name.upper().startswith(NEEDED_BEGINNINGS)
    }
    own = tempfile.mkdtemp(prefix="bench-tests-")
    atexit.register(shutil.rmtree, own, ignore_errors=True)
    homes = dict.fromkeys(("HOME", "USERPROFILE", "APPDATA", "LOCALAPPDATA"), own)
    temporary = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), own)
    caches = {"NUMBA_CACHE_DIR": str(ROOT / ".test-cache"), "MPLCONFIGDIR": str(ROOT / ".test-cache" / "matplotlib")}
    os.environ.clear()
    os.environ.update({"LANG": "C.UTF-8", "SHAKERBENCH_EFFECTS": "", "PYTEST_DEBUG_TEMPROOT": machine} | given)
    os.environ.update(homes | temporary | caches)
    tempfile.tempdir = None  # asked for again


_isolate()

Started = tuple["Profile", str, subprocess.Popen[str]]


def _missing() -> str:
    """What this machine lacks to run the audio driver; empty where nothing."""
    if shutil.which("jackd") is None:
        return "no jackd on this machine (Debian: apt-get install jackd2)"
    try:
        import jack  # noqa: F401
        import sounddevice  # noqa: F401
    except (ImportError, OSError) as error:
        return f"no audio driver on this machine ({error}; Debian: apt-get install libportaudio2 jackd2)"
    return ""


@contextmanager
def virtual_rig(
    folder: Path, *changes: tuple[str, str], period: int = 2048, server: str | None = None
) -> Iterator[Started]:
    """`bench virtual` on a JACK server of its own, or a named one: the profile as changed, its text, and the process.

    Where the audio driver is not installed the test skips; where it is, and the rig does not come up, the test fails.
    The period and the buffer are generous, because a machine that runs tests is busy.
    """
    from bench.profiles.find import load
    from rig.profile import parse_profile

    missing = _missing()
    if missing:
        pytest.skip(missing)
    _, text = load("soundcard")
    for old, new in (("rate_hz = 48000", "rate_hz = 20000"), ("buffer_s = 0.02", "buffer_s = 0.15"), *changes):
        assert old in text, old
        text = text.replace(old, new)
    path, log = folder / "card.toml", folder / "virtual.log"
    path.write_text(text, encoding="utf-8")
    server = server or f"bench-{os.getpid()}-{time.monotonic_ns() % 10**6}"
    code = "from bench.cli import main; main()"
    call = [sys.executable, "-c", code, "virtual", str(path), "--server", server, "--period", str(period)]
    with log.open("w", encoding="utf-8") as errors:
        process = subprocess.Popen(call, stdout=subprocess.PIPE, stderr=errors, text=True)
    before = os.environ.get("JACK_DEFAULT_SERVER")
    os.environ["JACK_DEFAULT_SERVER"] = server
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        if "ready" not in line:
            pytest.fail(f"jackd is installed, but bench virtual does not come up: {line} {log.read_text('utf-8')}")
        yield parse_profile(text, "card.toml"), text, process
    finally:
        process.terminate()
        process.communicate(timeout=20)
        os.environ.pop("JACK_DEFAULT_SERVER")
        if before is not None:
            os.environ["JACK_DEFAULT_SERVER"] = before


@pytest.fixture(scope="session")
def virtual_sound(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Profile, str]]:
    """A sound card's profile with its text, and the plant that answers to it as long as the tests run."""
    with virtual_rig(tmp_path_factory.mktemp("card")) as (profile, text, _):
        yield profile, text


@pytest.fixture
def virtual_card(virtual_sound: tuple[Profile, str]) -> Profile:
    """The profile alone."""
    return virtual_sound[0]


@pytest.fixture(scope="session")
def virtual_both(
    tmp_path_factory: pytest.TempPathFactory, virtual_sound: tuple[Profile, str]
) -> Iterator[tuple[Profile, str]]:
    """A profile of card and serial device with its text, and the plant behind both, on `virtual_sound`'s server."""
    folder = tmp_path_factory.mktemp("both")
    kind = f'kind = "soundcard+serial"\nport = "{(folder / "port").as_posix()}"'
    changes = (('kind = "soundcard"', kind), ('device = "shaker"', 'device = "both"'))
    with virtual_rig(folder, *changes, server=os.environ["JACK_DEFAULT_SERVER"]) as (profile, text, _):
        yield profile, text


class CardTap:
    """All that a card was given to play and all that it delivered, taken down in the driver's callback.

    ``played``: (card's frame, samples, drive handed over up to before and after the call); ``heard``: frames in order;
    ``begun``: index in ``heard`` of the first frame handed out, and the card's frame of the first drive sample.
    """

    def __init__(self) -> None:
        self.played: list[tuple[int, np.ndarray, int, int]] = []
        self.heard: list[np.ndarray] = []
        self.begun = (0, 0)

    def open_stream(
        self, device: str, rate_hz: float, output: int, n_inputs: int, exchange: Any, woke: Callable[[int], None]
    ) -> Any:
        """`rig.backends.portaudio.open_stream` with the callback watched."""
        from rig.backends.portaudio import open_stream

        ring = exchange.__self__
        begin = ring.begin
        self.played, self.heard = [], []

        def watched(heard: np.ndarray | None, out: np.ndarray, counter: int | None) -> None:
            before = ring.written
            exchange(heard, out, counter)
            self.played.append((ring.at - len(out), out.copy(), before, ring.written))
            if heard is not None:
                self.heard.append(heard.copy())

        def noted(ahead: int) -> int:
            frame: int = begin(ahead)
            self.begun = ring._taken, ring.written
            return frame

        ring.begin = noted
        return open_stream(device, rate_hz, output, n_inputs, watched, woke)


@pytest.fixture
def card_tap(monkeypatch: pytest.MonkeyPatch) -> CardTap:
    """A watch on what the sound card plays and delivers, through the real driver."""
    tap = CardTap()
    monkeypatch.setattr("rig.backends.soundcard.open_stream", tap.open_stream)
    return tap


@pytest.fixture
def rehearse(tmp_path: Path) -> Callable[..., object]:
    """`virtual_rig` in this test's own folder."""
    return lambda *changes, **options: virtual_rig(tmp_path, *changes, **options)


@pytest.fixture(scope="session")
def closed_loop() -> ClosedLoop:
    """A closed loop made of plain numbers: nine steps at c = 1, friction found, take-offs late by 50 us before.

    Tests that need another verdict replace fields of it; nothing is fitted.
    """
    from analysis.attribution.hypothesis import ChanceTest
    from analysis.loop.result import (
        AddedEffect,
        Calibration,
        ClosedLoop,
        DetectionLimits,
        FittedParameter,
        FlightTable,
        HeldOutErrors,
        PlateTable,
        Predictions,
        Selection,
        Source,
        StepTable,
        TestedCandidate,
    )
    from analysis.residuals.covariates import COVARIATES
    from analysis.residuals.lack_of_fit import GoodnessOfFit
    from analysis.residuals.prediction_errors import Errors, GivenOpenings
    from analysis.thresholds import FROZEN
    from daq.setup.setup import Setup

    rng = np.random.default_rng(3)
    m, n, r = 9, 108, 36
    setup = Setup.model_validate(
        {
            "name": "test",
            "forcing": {"frequency_hz": 25.37, "ratio": 1},
            "channels": {"accelerometer": {"sensitivity": 0.1, "unit": "V/g"}},
            "ball": {"mass_kg": 0.25},
        }
    )
    step, scored, from_rest = np.arange(n) // (n // m), np.arange(n) % 12 > 0, np.arange(n) % 3 == 1
    takeoff, sigma = 0.05 * np.arange(n), np.full(n, 5e-6)
    landing = takeoff + 0.03

    def predictions(late_s: float) -> Predictions:
        a, b = (late_s + sigma * rng.standard_normal(n) for _ in range(2))
        residuals = np.where(from_rest, a, np.nan), np.where(scored, b, np.nan)
        return Predictions(takeoff - a, landing - b, *residuals, sigma, sigma)

    values = {name: rng.random(n) for name in COVARIATES}
    values["previous_flight_s"][0] = np.nan
    kind, plate_sigma = np.arange(r) % 4, np.full(r, 1e-3)
    plate = [plate_sigma * rng.standard_normal(r) for _ in range(3)]
    up = AddedEffect("coulomb_friction", {"mu_up": (0.1, 0.09, 0.11), "mu_down": (0.11, 0.1, 0.12)})
    return ClosedLoop(
        verdict="explained",
        failed=(),
        selection=Selection(
            effects=(up,),
            names=("coulomb_friction",),
            ties=(("coulomb_friction",), ("stribeck_friction",)),
            parameters=(
                FittedParameter("coulomb_friction", "mu_up", 0.1, 0.005, True),
                FittedParameter("coulomb_friction", "mu_down", 0.11, 0.005, True),
                FittedParameter("contact_latency", "delay_s", 2e-6, 1e-6, False),
            ),
            calibrations=(Calibration("accelerometer_gain", "relative", 1e-3, 1e-4, 0.0, 5e-4),),
            candidates=(
                TestedCandidate(("adhesion",), 3.0, math.inf),
                TestedCandidate(("coulomb_friction",), 900.0, 80.0),
            ),
            rounds=("round 1: coulomb_friction gains 900 +- 80 nats",),
            rejected=None,
            chance=(ChanceTest(("coulomb_friction",), 910.0, 2e-4, 9.1, True),),
        ),
        discovered=None,
        errors=HeldOutErrors(
            before=Errors(52.0, 50.0, 54.0, 74.0, 74.0, 52.0, 2e-3, 24, 0.0),
            after=Errors(5.0, 4.0, 6.0, 5.1, 5.2, 5.0, 1e-4, 24, 0.0),
            given_openings=GivenOpenings(4.9, 5.0, 8.0),
            landing_floor_us=5.0,
            takeoff_floor_us=5.0,
        ),
        remainder=GoodnessOfFit(0.4, 1.02, 1.01, None, dict.fromkeys(COVARIATES, 0.5), 0.3, 0.5, 0.6),
        detection=DetectionLimits(
            {"viscous_damping.rate_per_s": 0.02, "restitution.e0": math.inf}, ("table_resonance",)
        ),
        steps=StepTable(
            np.zeros(m, np.int64),
            np.arange(m),
            np.linspace(0.55, 1.3, m),
            np.ones(m, np.int64),
            np.full(m, 1 / 25.37),
            np.arange(m) % 4 == 2,
        ),
        flights=FlightTable(step, takeoff, landing, scored, from_rest, predictions(5e-5), predictions(0.0), values),
        plate=PlateTable(kind, np.arange(r) % m, plate[0], plate_sigma, plate[1], plate[2]),
        setup=setup,
        limits=FROZEN,
        sources=(
            Source(
                "run.h5", "test (a rig)", "2026-01-02T03:04:05", "simulated", True, "", "0.1.0", "abc", "", "run.h5"
            ),
        ),
        notes=("a note on the data",),
    )
