"""A strict stand-in for the parts of the package `nidaqmx` that `rig.backends.nidaqmx` uses, on the simulated rig.

It follows NI's manual where that is stricter than convenience: tasks are configured before they
start, an output on a clock that does not run waits, written samples are never played twice, and a buffer that runs dry
or over is an error that lasts. It has no driver behind it; it tests the calls, not the hardware.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace, TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from kernels.arrays import Floats
from rig.sim.plant import Plant
from rig.sim.scenario import Scenario


class DaqError(Exception):
    """As ``nidaqmx.errors.Error``: one class for all faults."""


class Bench:
    """The device: a plant whose output buffer is played as its inputs are read.

    Attributes
    ----------
    output_v : float
        What the output holds.
    unplugged : bool
        Set by a test: every call then fails.
    calls : int
        Calls of the driver that reached the device.
    """

    def __init__(self, rate_hz: float, seed: int = 1) -> None:
        self.unplugged = False
        self.output_v = 0.0
        self.calls = 0
        self._rate_hz, self._seed = rate_hz, seed
        self.reset()
        self.package = SimpleNamespace(
            Task=lambda: _Task(self),
            errors=SimpleNamespace(Error=DaqError),
            constants=SimpleNamespace(
                AcquisitionType=SimpleNamespace(CONTINUOUS="continuous"),
                RegenerationMode=SimpleNamespace(DONT_ALLOW_REGENERATION="once"),
            ),
            stream_readers=SimpleNamespace(AnalogUnscaledReader=_Reader),
            stream_writers=SimpleNamespace(AnalogSingleChannelWriter=_Writer),
        )

    def reset(self) -> None:
        """A plate at rest, an empty buffer."""
        self._plant = Plant(Scenario("ideal"), self._rate_hz, np.random.default_rng(self._seed))
        self._written = np.zeros(0)
        self.clock_runs = self.armed = False

    def check(self) -> None:
        """Count a call; raise what a missing device raises."""
        self.calls += 1
        if self.unplugged:
            raise DaqError("Device is not available: it has been removed. Status Code: -88709")

    def write(self, volts: Floats) -> None:
        """Into the output buffer."""
        self.check()
        self._written = np.concatenate([self._written, volts])

    def read(self, n: int) -> NDArray[np.int16]:
        """Let the clock run ``n`` samples: the output plays them, the inputs (3, n) see what comes of it."""
        self.check()
        if not (self.clock_runs and self.armed):
            raise DaqError("The sample clock does not run, or the output is not armed. Status Code: -200284")
        if len(self._written) < n:
            raise DaqError("The generation is not able to keep up: no samples left. Status Code: -200290")
        play, self._written = self._written[:n], self._written[n:]
        self.output_v = float(play[-1])
        return self._plant.exchange(play).T

    @property
    def volts_per_code(self) -> float:
        """Of every input."""
        return float(self._plant.channel_scales["drive"])


class _Channels:
    """``ai_channels`` or ``ao_channels`` of a task."""

    def __init__(self, task: _Task) -> None:
        self._task = task
        self._names: list[str] = []

    def add_ai_voltage_chan(self, physical_channel: str, *, min_val: float, max_val: float) -> None:
        self._add(physical_channel, "/ai", min_val, max_val)

    def add_ao_voltage_chan(self, physical_channel: str, *, min_val: float, max_val: float) -> None:
        self._add(physical_channel, "/ao", min_val, max_val)

    def _add(self, name: str, kind: str, low: float, high: float) -> None:
        self._task.bench.check()
        if not name.startswith("Dev1" + kind) or not -10.0 <= low < high <= 10.0:
            raise DaqError(f"Physical channel specified does not exist: {name}. Status Code: -200170")
        if self._task.started:
            raise DaqError("Channels cannot be added to a running task. Status Code: -200986")
        self._names.append(name)

    def __iter__(self) -> Iterator[Any]:
        scale = self._task.bench.volts_per_code
        return iter([SimpleNamespace(ai_dev_scaling_coeff=[0.0, scale, 0.0, 0.0]) for _ in self._names])

    def __len__(self) -> int:
        return len(self._names)


class _Timing:
    """``timing`` of a task."""

    def __init__(self, task: _Task) -> None:
        self._task = task
        self.samp_clk_rate = 0.0

    def cfg_samp_clk_timing(self, rate: float, source: str = "", *, sample_mode: str, samps_per_chan: int) -> None:
        if self._task.started or sample_mode != "continuous" or samps_per_chan < 2:
            raise DaqError("Timing must be configured before the task starts. Status Code: -200986")
        self._task.source = source
        self.samp_clk_rate = 100e6 / round(100e6 / rate)  # a divider of the time base


class _Task:
    """``nidaqmx.Task``."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.started = self.closed = False
        self.source = ""
        self.ai_channels, self.ao_channels = _Channels(self), _Channels(self)
        self.timing = _Timing(self)
        self.in_stream = self.out_stream = SimpleNamespace(task=self, regen_mode="")

    def start(self) -> None:
        self.bench.check()
        self.started = True
        if len(self.ao_channels):
            if self.source != "/Dev1/ai/SampleClock" or self.out_stream.regen_mode != "once":
                raise DaqError("The output would run on a clock of its own, or repeat itself.")
            self.bench.armed = True
        else:
            self.bench.clock_runs = True

    def write(self, volts: float) -> None:
        """On demand: the output takes the voltage at once."""
        self.bench.check()
        if self.bench.armed:
            raise DaqError("The specified resource is reserved. Status Code: -50103")
        self.bench.output_v = volts

    def close(self) -> None:
        if self.closed:
            raise DaqError("Task was closed already.")
        self.closed = True
        if self.started:
            self.bench.reset()
        self.bench.check()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


class _Reader:
    """``stream_readers.AnalogUnscaledReader``."""

    def __init__(self, in_stream: Any) -> None:
        self._task = in_stream.task

    def read_int16(self, data: NDArray[np.int16], number_of_samples_per_channel: int, timeout: float) -> int:
        if data.shape != (len(self._task.ai_channels), number_of_samples_per_channel) or data.dtype != np.int16:
            raise DaqError("Array is shaped incorrectly.")
        data[:] = self._task.bench.read(number_of_samples_per_channel)
        return number_of_samples_per_channel


class _Writer:
    """``stream_writers.AnalogSingleChannelWriter``."""

    def __init__(self, out_stream: Any, auto_start: bool) -> None:
        self._task = out_stream.task
        if auto_start:
            raise DaqError("An output that starts by itself does not start with the inputs.")

    def write_many_sample(self, data: Floats, timeout: float) -> int:
        self._task.bench.write(np.asarray(data, np.float64))
        return len(data)
