"""TDMS of LabVIEW and DIAdem: codes with their linear scale, a segment for each piece of time.

Waveform properties say the rate. Where samples were lost or times are uneven, a channel ``time_s`` says every time.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from daq.export.columnar import pieces
from daq.export.facts import facts, missing, step_columns
from daq.recording.reader import Recording

GROUP = "recording"
RAW = 0xFFFFFFFF  # input source of a scale: the stored numbers
Progress = Callable[[int], None]


def export_tdms(recording: Recording, part: Path, tell: Progress) -> None:
    """Write the file, segment by segment."""
    try:
        from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter
    except ImportError as error:
        raise missing("npTDMS", "TDMS") from error
    timed = bool(len(recording.gaps)) or not recording.stored.get("uniform", True)
    told: dict[str, Any] = {name: _text(value) for name, value in facts(recording).items()}
    with TdmsWriter(str(part)) as writer:
        writer.write_segment([RootObject({"name": recording.path.name, **told}), GroupObject(GROUP)])
        for a, b in pieces(recording.n_samples):
            channels = []
            if timed:
                properties = {"unit_string": "s"} if a == 0 else {}
                channels.append(ChannelObject(GROUP, "time_s", recording.timestamps_ns(a, b) * 1e-9, properties))
            for name in recording.channels:
                properties = _properties(recording, name) if a == 0 else {}
                channels.append(ChannelObject(GROUP, name, recording.codes(name, a, b), properties))
            writer.write_segment(channels)
            tell(b)
        tables = {"steps": step_columns(recording), "gaps": _gap_columns(recording)}
        writer.write_segment(
            [ChannelObject(group, name, column) for group, table in tables.items() for name, column in table.items()]
        )


def _gap_columns(recording: Recording) -> dict[str, np.ndarray]:
    gaps = np.asarray(recording.gaps, np.int64)
    return {"first_sample_after": np.ascontiguousarray(gaps[:, 0]), "samples_lost": np.ascontiguousarray(gaps[:, 1])}


def _properties(recording: Recording, name: str) -> dict[str, Any]:
    """Waveform and scale of a channel, as DAQmx writes them."""
    from nptdms.types import Uint32

    factor, offset = recording.scale(name)
    started = _time(str(recording.stored.get("started") or ""))
    out: dict[str, Any] = {
        "unit_string": "V",
        "wf_increment": 1.0 / recording.rate_hz,
        "wf_start_offset": 0.0,
        "wf_samples": 1,
        "NI_Number_Of_Scales": Uint32(1),
        "NI_Scaling_Status": "unscaled",
        "NI_Scale[0]_Scale_Type": "Linear",
        "NI_Scale[0]_Linear_Slope": float(factor),
        "NI_Scale[0]_Linear_Y_Intercept": float(offset),
        "NI_Scale[0]_Linear_Input_Source": Uint32(RAW),
    }
    return out if started is None else out | {"wf_start_time": started}


def _time(text: str) -> np.datetime64 | None:
    """The start as TDMS keeps it, UTC; None where the recording does not say."""
    if not text:
        return None
    when = datetime.datetime.fromisoformat(text).astimezone(datetime.UTC).replace(tzinfo=None)
    return np.datetime64(when, "us")


def _text(value: str | float | int) -> str | float | int:
    return value.replace("\x00", "") if isinstance(value, str) else value
