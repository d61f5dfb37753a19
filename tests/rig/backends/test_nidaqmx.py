"""The NI-DAQmx back end against a strict stand-in for the driver, and against the package's own names."""

from __future__ import annotations

import inspect
from pathlib import Path

import numpy as np
import pytest

from bench.profiles.find import load
from daq.recording import open_recording, verify
from daq.recording.writer import RecordingWriter
from rig.backends.base import BackendError, running
from rig.backends.nidaqmx import NiDaqmxBackend
from rig.execution.run import run_ramp
from rig.profile import parse_profile
from tests.fakes.nidaqmx_bench import Bench

RATE = 20000.0
LEAD = 2000
TERMINALS = {"continuity": "Dev1/ai0", "accelerometer": "Dev1/ai1", "drive": "Dev1/ai2"}
RANGES_V = dict.fromkeys(TERMINALS, 10.0)


def on(bench: Bench, rate_hz: float = RATE, terminals: dict[str, str] = TERMINALS) -> NiDaqmxBackend:
    """The back end on a bench, with 0.1 s of drive in its buffer."""
    return NiDaqmxBackend(rate_hz, terminals, RANGES_V, "Dev1/ao0", lead_s=LEAD / RATE, daqmx=bench.package)


def test_frames_come_behind_the_drive_and_say_so() -> None:
    """What is looped back is what was played, exactly where each block says that it belongs."""
    played = np.sin(np.arange(12_000) / 90.0)
    backend = on(Bench(RATE))
    with running(backend):
        blocks = [backend.exchange(piece) for piece in np.split(played, [100, 3100, 3101])]
    heard = np.concatenate([block.codes[:, 2] for block in blocks]) * backend.scales["drive"][0]
    assert [block.place for block in blocks] == [first - LEAD for first in (0, 100, 3100, 3101)]
    assert np.abs(heard[LEAD:] - played[: heard.size - LEAD]).max() < 0.01
    assert np.abs(heard[:LEAD]).max() < 0.01


def test_a_whole_run_has_its_steps_where_they_are(tmp_path: Path) -> None:
    """Steps in the recording begin where the drive of the step is heard, the buffer's lead taken into account."""
    _, text = load("simulated")
    text = text.replace("start = 0.4, stop = 2.6, steps = 23", "start = 0.8, stop = 1.2, steps = 2")
    profile = parse_profile(text)
    backend = on(Bench(RATE))
    writer = RecordingWriter(
        tmp_path / "run.h5", profile.setup(), profile_text=text, channels=backend.channels, backend=backend.name,
        simulated=False, scales=backend.scales,
    )  # fmt: skip
    assert run_ramp(profile, backend, writer).how == "complete"
    assert verify(tmp_path / "run.h5").state == "complete"
    with open_recording(tmp_path / "run.h5") as recording:
        heard, steps = recording.read_v("drive"), recording.steps
    assert steps["first_sample"][0] == LEAD
    for step in steps:
        hold = heard[step["first_sample"] + step["settle_samples"] : step["first_sample"] + step["n_samples"]]
        assert np.ptp([np.abs(piece).max() for piece in np.array_split(hold, 10)]) < 0.005


def test_unplugged_it_says_which_device_and_what_the_driver_said() -> None:
    """The device goes: a back end error with its name and NI's own text; stopping it then is no error."""
    bench = Bench(RATE)
    backend = on(bench)
    backend.start()
    backend.exchange(np.ones(100))
    bench.unplugged = True
    with pytest.raises(BackendError, match=r"nidaqmx Dev1: stopped working .*removed.*-88709"):
        backend.exchange(np.ones(100))
    backend.stop()


def test_it_ends_at_zero_volts() -> None:
    """Closing the tasks leaves an output where it was; the back end puts it to 0 V."""
    bench = Bench(RATE)
    backend = on(bench)
    backend.start()
    for _ in range(50):
        backend.exchange(np.full(100, 3.0))
    assert bench.output_v == 3.0
    backend.stop()
    assert bench.output_v == 0.0


def test_a_rate_that_it_cannot_do_is_refused_with_the_one_it_can() -> None:
    """A rate that the device would round is an error, not another time base."""
    with pytest.raises(BackendError, match=r"cannot sample at 30001 Hz, its nearest is 30003\.\d+ Hz"):
        on(Bench(30001.0), 30001.0).start()


def test_a_wrong_terminal_is_refused_before_anything_moves() -> None:
    """The driver's complaint about a terminal comes when the back end is made."""
    with pytest.raises(BackendError, match=r"cannot be opened .*Dev7/ai0"):
        on(Bench(RATE), terminals=TERMINALS | {"continuity": "Dev7/ai0"})


def test_without_the_package_it_says_what_to_install() -> None:
    """No nidaqmx on this machine: the error names the extra."""
    try:
        import nidaqmx  # noqa: F401
    except ImportError:
        with pytest.raises(BackendError, match=r"pip install 'shakerbench\[nidaqmx\]'"):
            NiDaqmxBackend(RATE, TERMINALS, RANGES_V, "Dev1/ao0")
    else:
        pytest.skip("nidaqmx is installed here")


def test_the_package_has_what_is_used_of_it() -> None:
    """Where nidaqmx is installed: every name and argument that the back end uses exists (no driver is needed)."""
    kit = pytest.importorskip("nidaqmx", reason="the extra nidaqmx is not installed")
    from nidaqmx import stream_readers, stream_writers
    from nidaqmx.constants import AcquisitionType, RegenerationMode
    from nidaqmx.errors import DaqError, DaqNotFoundError, Error
    from nidaqmx.task import InStream, OutStream
    from nidaqmx.task._timing import Timing
    from nidaqmx.task.channels import AIChannel
    from nidaqmx.task.collections import AIChannelCollection, AOChannelCollection

    assert issubclass(DaqError, Error) and issubclass(DaqNotFoundError, Error)
    assert AcquisitionType.CONTINUOUS and RegenerationMode.DONT_ALLOW_REGENERATION
    used = {
        kit.Task.write: {"data"},
        kit.Task.close: set(),
        AIChannelCollection.add_ai_voltage_chan: {"physical_channel", "min_val", "max_val"},
        AOChannelCollection.add_ao_voltage_chan: {"physical_channel", "min_val", "max_val"},
        Timing.cfg_samp_clk_timing: {"rate", "source", "sample_mode", "samps_per_chan"},
        stream_readers.AnalogUnscaledReader.read_int16: {"data", "number_of_samples_per_channel", "timeout"},
        stream_writers.AnalogSingleChannelWriter.write_many_sample: {"data", "timeout"},
        stream_writers.AnalogSingleChannelWriter.__init__: {"task_out_stream", "auto_start"},
        stream_readers.AnalogUnscaledReader.__init__: {"task_in_stream"},
    }
    for function, names in used.items():
        assert names <= set(inspect.signature(function).parameters), function
    for owner, name in ((Timing, "samp_clk_rate"), (OutStream, "regen_mode"), (AIChannel, "ai_dev_scaling_coeff")):
        assert isinstance(inspect.getattr_static(owner, name), property), name
    assert InStream and hasattr(AIChannelCollection, "__iter__")
