"""TDMS of LabVIEW and DIAdem: codes with their linear scale, a segment for each piece of time.

Waveform properties say the rate. Where samples were lost or times are uneven, a channel ``time_s`` says every time.
"""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

import numpy as np

from daq.export.facts import Progress, facts, pieces, step_columns
from daq.recording.reader import Recording
from daq.setup.errors import package

GROUP = "recording"


def export_tdms(recording: Recording, part: Path, tell: Progress) -> None:
    """Write the file, segment by segment."""
    with package("npTDMS", "TDMS needs"):
        from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter
    timed = bool(len(recording.gaps)) or not recording.stored.get("uniform", True)
    stated: dict[str, Any] = facts(recording)
    stated = {k: v.replace("\x00", "") if isinstance(v, str) else v for k, v in stated.items()}
    with TdmsWriter(str(part)) as writer:
        writer.write_segment([RootObject({"name": recording.path.name, **stated}), GroupObject(GROUP)])
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
        gaps = np.asarray(recording.gaps, np.int64)
        first, lost = (np.ascontiguousarray(gaps[:, i]) for i in (0, 1))
        tables = {"steps": step_columns(recording), "gaps": {"first_sample_after": first, "samples_lost": lost}}
        writer.write_segment(
            [ChannelObject(group, name, column) for group, table in tables.items() for name, column in table.items()]
        )


def _properties(recording: Recording, name: str) -> dict[str, Any]:
    """Waveform and scale of a channel, as DAQmx writes them."""
    from nptdms.types import Uint32

    factor, offset = recording.scale(name)
    started = str(recording.stored.get("started") or "")
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
        "NI_Scale[0]_Linear_Input_Source": Uint32(0xFFFFFFFF),
    }
    if started:
        when = datetime.datetime.fromisoformat(started).astimezone(datetime.UTC).replace(tzinfo=None)
        out["wf_start_time"] = np.datetime64(when, "us")
    return out
