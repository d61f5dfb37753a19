"""Options of the replay of a recording."""

from __future__ import annotations

from typing import Literal

from rig.backends.kinds.base import BackendKind, BackendOptions


class ReplayOptions(BackendOptions):
    """A recording in place of the device; ``bench ramp --replay`` names it."""

    kind: Literal["replay"] = "replay"


BACKEND = BackendKind(ReplayOptions, "rig.backends.replay:open_replay", frozenset({"replay"}))
