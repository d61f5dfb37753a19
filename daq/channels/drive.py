"""The drive, looped back. It finds steps and lost samples; its scale is the setup's ``[drive]``, tone by tone."""

from __future__ import annotations

from typing import ClassVar

from daq.channels.base import Channel


class DriveChannel(Channel):
    """The looped-back drive voltage."""

    long_name: ClassVar[str] = "looped-back drive voltage"
    aliases: ClassVar[frozenset[str]] = frozenset(
        {"drive", "drivevoltage", "loopback", "loopbackdrive", "driveloopback", "excitation", "command"}
    )
