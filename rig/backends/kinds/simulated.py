"""Options of the simulated rig."""

from __future__ import annotations

from typing import Literal

from rig.backends.kinds.base import BackendKind, BackendOptions


class SimulatedOptions(BackendOptions):
    """The simulated rig, at full speed or paced."""

    kind: Literal["simulated"] = "simulated"


BACKEND = BackendKind(SimulatedOptions, "rig.backends.simulated:open_simulated", frozenset({"scenario", "real_time"}))
