"""Options of an NI-DAQmx device."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from rig.backends.kinds.base import BackendKind, BackendOptions


class NiDaqmxOptions(BackendOptions):
    """An NI device; ``terminal`` of each channel names its input."""

    required: ClassVar[tuple[str, ...]] = ("device",)

    kind: Literal["nidaqmx"] = "nidaqmx"
    device: str = Field(default="", description="the analog output that drives the amplifier, as Dev1/ao0")
    output_range_v: float = Field(default=10.0, gt=0, description="volts at full scale of the output")
    buffer_s: float = Field(default=0.02, gt=0, le=1, description="drive held in the output buffer")


BACKEND = BackendKind(NiDaqmxOptions, "rig.backends.nidaqmx:open_nidaqmx")
