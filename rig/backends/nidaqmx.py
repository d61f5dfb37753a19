"""NI-DAQmx: analog output and inputs of one device on one sample clock. **Never run on hardware here.**

Needs NI's driver and the extra ``shakerbench[nidaqmx]``. The output runs on the inputs' own sample
clock, so one clock counts both; an output that is late or a buffer that overflows is the driver's error, and stops the
run. Frames come behind the drive by what lies in the output buffer, and each block says so by its place.
"""

from __future__ import annotations

import contextlib
import importlib
import time
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from daq.files.tables import Block
from daq.setup.errors import InputError
from kernels.arrays import Floats
from rig.backends.base import BackendError, checked_drive
from rig.backends.kinds.base import OpenOptions
from rig.backends.kinds.nidaqmx import NiDaqmxOptions
from rig.profile import Profile

PATIENCE_S = 1.0  # a read or write that takes longer means a device that stands still
FULL = 32767


class NiDaqmxBackend:
    """One NI device.

    Raises `BackendError` when the package, the driver or the device is missing, or the device cannot do what is asked.

    Parameters
    ----------
    rate_hz
        Samples a second; the device must be able to do it exactly.
    terminals
        Input by channel name, as ``{"continuity": "Dev1/ai0", ...}``, in the order of a frame's columns.
    ranges_v
        Full scale asked for, by channel name.
    output
        Where the drive goes, as ``Dev1/ao0``.
    drive_range_v
        Full scale of the output.
    lead_s
        Drive held in the output buffer; the interlock sees the plate so much later.
    daqmx
        The package `nidaqmx`; a test hands in one of its own.
    """

    name = "nidaqmx"
    simulated = False
    scenario_sha256: str | None = None

    def __init__(
        self,
        rate_hz: float,
        terminals: Mapping[str, str],
        ranges_v: Mapping[str, float],
        output: str,
        *,
        drive_range_v: float = 10.0,
        lead_s: float = 0.02,
        daqmx: Any = None,
    ) -> None:
        try:
            self._nidaqmx = importlib.import_module("nidaqmx") if daqmx is None else daqmx
            for part in ("constants", "errors", "stream_readers", "stream_writers") if daqmx is None else ():
                importlib.import_module(f"nidaqmx.{part}")
        except ImportError as error:
            raise BackendError(
                "nidaqmx is not installed: pip install 'shakerbench[nidaqmx]', and NI's driver"
            ) from error
        self.rate_hz = rate_hz
        self.channels = tuple(terminals)
        self._terminals, self._ranges_v = dict(terminals), dict(ranges_v)
        self._output, self._drive_range_v = output, drive_range_v
        self._device = output.split("/")[0]
        self._inputs: Any = None
        self._outputs: Any = None
        self._given = 0
        self._lead = round(lead_s * rate_hz)
        self.scales = self._calibration()

    def start(self) -> None:
        """Arm the output with silence, then start the inputs, whose clock moves both."""
        self.stop()
        kit = self._nidaqmx
        mode, held = kit.constants.AcquisitionType.CONTINUOUS, round(4.0 * self.rate_hz)
        try:
            self._inputs, self._outputs = self._input_task(), kit.Task()
            self._inputs.timing.cfg_samp_clk_timing(self.rate_hz, sample_mode=mode, samps_per_chan=held)
            true_hz = float(self._inputs.timing.samp_clk_rate)
            if abs(true_hz / self.rate_hz - 1.0) > 1e-9:
                raise BackendError(
                    f"nidaqmx {self._device}: cannot sample at {self.rate_hz:g} Hz, its nearest is {true_hz!r} Hz; "
                    "set sampling.rate_hz to that"
                )
            span_v = self._drive_range_v
            self._outputs.ao_channels.add_ao_voltage_chan(self._output, min_val=-span_v, max_val=span_v)
            self._outputs.timing.cfg_samp_clk_timing(
                self.rate_hz, source=f"/{self._device}/ai/SampleClock", sample_mode=mode, samps_per_chan=held
            )
            self._outputs.out_stream.regen_mode = kit.constants.RegenerationMode.DONT_ALLOW_REGENERATION
            self._reader = kit.stream_readers.AnalogUnscaledReader(self._inputs.in_stream)
            self._writer = kit.stream_writers.AnalogSingleChannelWriter(self._outputs.out_stream, auto_start=False)
            self._writer.write_many_sample(np.zeros(self._lead), timeout=PATIENCE_S)
            self._outputs.start()  # waits for the clock
            self._inputs.start()
        except kit.errors.Error as error:
            self.stop()
            raise self._failed("cannot be started", error) from error
        except BackendError:
            self.stop()
            raise
        self._given = 0

    def exchange(self, drive_v: Floats) -> Block:
        """Append ``drive_v`` to the output buffer, wait for as many frames (raises BackendError with NI's text)."""
        drive = checked_drive(drive_v)
        if self._inputs is None:
            raise BackendError("not started")
        codes = np.empty((len(self.channels), len(drive)), np.int16)
        if len(drive):
            try:
                self._writer.write_many_sample(drive, timeout=PATIENCE_S)
                self._reader.read_int16(codes, number_of_samples_per_channel=len(drive), timeout=PATIENCE_S)
            except self._nidaqmx.errors.Error as error:
                raise self._failed("stopped working", error) from error
        first, self._given = self._given, self._given + len(drive)
        frames = np.ascontiguousarray(codes.T)
        return Block(first, frames, clock_ns=time.monotonic_ns(), place=first - self._lead)

    def stop(self) -> None:
        """Let go of both tasks and put the output to 0 V; may be called at any time."""
        inputs, outputs, gone = self._inputs, self._outputs, self._nidaqmx.errors.Error
        self._inputs = self._outputs = None
        for task in (inputs, outputs):
            with contextlib.suppress(gone):
                if task is not None:
                    task.close()
        if outputs is not None:
            # one sample of 0 V, unbuffered: a task that is closed leaves the output at its last voltage
            with contextlib.suppress(gone), self._nidaqmx.Task() as task:
                span_v = self._drive_range_v
                task.ao_channels.add_ao_voltage_chan(self._output, min_val=-span_v, max_val=span_v)
                task.write(0.0)

    def _input_task(self) -> Any:
        """A task with every input, in the order of the channels."""
        task = self._nidaqmx.Task()
        for name in self.channels:
            span_v = self._ranges_v[name]
            task.ai_channels.add_ai_voltage_chan(self._terminals[name], min_val=-span_v, max_val=span_v)
        return task

    def _calibration(self) -> dict[str, tuple[float, float]]:
        """``(volts_per_code, offset_v)`` of each input: the straight line nearest to the device's polynomial."""
        try:
            with self._input_task() as task:
                polynomials = {n: c.ai_dev_scaling_coeff for n, c in zip(self.channels, task.ai_channels, strict=True)}
        except self._nidaqmx.errors.Error as error:
            raise self._failed("cannot be opened", error) from error
        codes = np.linspace(-FULL, FULL, 101)
        scales = {}
        for name, coefficients in polynomials.items():
            offset_v, slope = np.polynomial.polynomial.polyfit(
                codes, np.polynomial.polynomial.polyval(codes, np.asarray(coefficients, np.float64)), 1
            )
            scales[name] = (float(slope), float(offset_v))
        return scales

    def _failed(self, what: str, error: Exception) -> BackendError:
        return BackendError(
            f"nidaqmx {self._device}: {what} ({error}); look at it in NI MAX, check its cable and terminals"
        )


def open_nidaqmx(profile: Profile, options: OpenOptions) -> NiDaqmxBackend:
    """The profile's device: inputs by each channel's ``terminal``, the output by ``backend.device`` (``Dev1/ao0``).

    Raises `InputError` when `NiDaqmxBackend` cannot be made.
    """
    wired = profile.channels.recorded()
    terminals = {name: channel.terminal for name, channel in wired.items()}
    ranges_v = {name: channel.range_v for name, channel in wired.items()}
    table, rate_hz = cast(NiDaqmxOptions, profile.backend), profile.sampling.rate_hz
    try:
        return NiDaqmxBackend(
            rate_hz, terminals, ranges_v, table.device, drive_range_v=table.output_range_v, lead_s=table.buffer_s
        )
    except BackendError as error:
        raise InputError(str(error)) from error
