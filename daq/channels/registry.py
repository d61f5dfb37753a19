"""The channels that a profile can describe: a new kind is a module of this folder and a line of `Channels`.

Decision 361.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, get_args

from pydantic import SerializerFunctionWrapHandler, model_serializer

from daq.channels.accelerometer import AccelerometerChannel
from daq.channels.base import Channel
from daq.channels.continuity import ContinuityChannel
from daq.channels.displacement import DisplacementChannel
from daq.channels.drive import DriveChannel
from daq.setup.values import Frozen


class Channels(Frozen):
    """The recorded channels in the order of a frame; continuity may be absent (then only the plate is analysed)."""

    continuity: ContinuityChannel | None = ContinuityChannel()
    accelerometer: AccelerometerChannel
    drive: DriveChannel = DriveChannel()
    displacement: DisplacementChannel | None = None

    def get(self, name: str) -> Channel | None:
        """The channel of that name; None where the profile does not describe it."""
        found: Channel | None = getattr(self, name) if name in KINDS else None
        return found

    def recorded(self) -> dict[str, Channel]:
        """Channels that the profile describes, by name in the order of a frame."""
        return {name: channel for name in KINDS if (channel := self.get(name)) is not None}

    @model_serializer(mode="wrap")
    def _without_further(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out a further channel that is absent: the text equals that of a file from before there was the kind."""
        table: dict[str, Any] = handler(self)
        return {name: value for name, value in table.items() if value is not None or name in CHANNELS}


KINDS: Mapping[str, type[Channel]] = {
    name: next(kind for kind in (field.annotation, *get_args(field.annotation)) if isinstance(kind, type))
    for name, field in Channels.model_fields.items()
}
"""Kinds by name, in the order of a frame."""

CHANNELS = tuple(name for name, field in Channels.model_fields.items() if field.is_required() or field.default)
"""Names of the channels that a profile describes unless it says otherwise, in the order of a frame."""
