"""Arming: a person allows one run of one profile on real hardware, for some minutes.

The desk's page writes the file; an agent's call takes it away before anything moves. It guards against an agent that
goes too far by mistake, not against a program that writes files on this machine.
"""

from __future__ import annotations

import hashlib
import json
import time
from pathlib import Path
from typing import Any

from daq.files.whole_file import write_whole
from daq.setup.errors import InputError

FILE = Path(".shakerbench", "armed.json")
LASTS_S = 600.0


def arm(folder: Path, profile_text: str, name: str) -> None:
    """Allow one run of exactly this profile below ``folder``, for `LASTS_S` (raises InputError)."""
    path = folder / FILE
    try:
        path.parent.mkdir(exist_ok=True)
        permit = {"profile": name, "profile_sha256": _digest(profile_text), "until": time.time() + LASTS_S}
        write_whole(path, json.dumps(permit) + "\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error}); make the runs' folder writable") from error


def armed(folder: Path) -> dict[str, Any]:
    """The profile that is armed below ``folder`` and the seconds left; None and 0 where none is."""
    try:
        found = json.loads((folder / FILE).read_text(encoding="utf-8"))
        name, left_s = str(found["profile"]), float(found["until"]) - time.time()
    except (OSError, ValueError, KeyError, TypeError):
        name, left_s = "", 0.0
    return {"profile": name, "left_s": left_s} if 0.0 < left_s <= LASTS_S else {"profile": None, "left_s": 0.0}


def disarm(folder: Path) -> None:
    """Allow nothing."""
    (folder / FILE).unlink(missing_ok=True)


def take(folder: Path, profile_text: str, name: str) -> None:
    """Use up the permission to run a profile.

    Raises `InputError` where there is none: none was given, it is over, used up, or of another profile.
    """
    try:
        found = json.loads((folder / FILE).read_text(encoding="utf-8"))
        is_armed = found["profile_sha256"] == _digest(profile_text) and armed(folder)["profile"] is not None
        if is_armed:
            (folder / FILE).unlink()  # of two calls at one time, the second finds it gone
    except (OSError, ValueError, KeyError, TypeError):
        is_armed = False
    if not is_armed:
        raise InputError(
            f"{name}: drives real hardware, and no person has armed it; ask one to open the desk's page (bench live), "
            f"section Agent, and to arm this profile: it holds for one run within {LASTS_S / 60.0:g} minutes"
        )


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()
