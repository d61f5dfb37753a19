"""Files that a request may name: those below the runs' folder, and no other."""

from __future__ import annotations

from pathlib import Path

from starlette.exceptions import HTTPException


def file_inside(folder: Path, name: str) -> Path:
    """The file ``name`` below ``folder``, links followed.

    Raises `starlette.exceptions.HTTPException` (404) where there is no such file or it lies elsewhere: a request
    learns nothing of the two.

    ``name`` is a relative path with forward slashes, from a request.
    """
    refused = HTTPException(404, "no such file in the runs' folder")
    parts = name.split("/")
    if not name or any(part in ("", ".", "..") or "\\" in part or ":" in part or "\0" in part for part in parts):
        raise refused
    try:
        path = folder.joinpath(*parts).resolve(strict=True)
        is_inside = path.is_relative_to(folder.resolve(strict=True)) and path.is_file()
    except (OSError, RuntimeError) as error:
        raise refused from error
    if not is_inside:
        raise refused
    return path
