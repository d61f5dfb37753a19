"""What a foreign rig hands over, as its owner imports it: volts in a table and a profile."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from daq.importers.formats.open import open_source
from daq.importers.import_recording import import_recording
from rig.profile import load_setup


def imported(volts: Mapping[str, np.ndarray], profile: str, folder: Path) -> Path:
    """The recording made of ``time_s`` and the channels' volts, (n,) each, and the text of a profile."""
    raw, described, out = folder / "recording.npz", folder / "profile.toml", folder / "recording.h5"
    np.savez(raw, allow_pickle=False, **volts)
    described.write_text(profile, encoding="utf-8")
    setup, text = load_setup(described)
    import_recording(open_source(raw), out, setup, text)
    return out
