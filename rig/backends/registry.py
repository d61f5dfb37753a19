"""Opening the back end that a profile asks for. Decision 128."""

from __future__ import annotations

import pkgutil

from daq.setup.errors import InputError
from rig.backends.base import Backend
from rig.backends.gate import gated
from rig.backends.kinds.base import OpenOptions, built_in, kind_of
from rig.backends.kinds.soundcard import CardOptions
from rig.profile import Profile


def open_backend(profile: Profile, options: OpenOptions | None = None) -> Backend:
    """The back end that ``profile`` asks for, and no other; not yet started.

    Raises `InputError` when an option is given that this kind does not heed, or the back end cannot be opened.
    """
    options, kind = options or OpenOptions(), kind_of(profile.backend.kind)
    for option in options.given():
        if option not in kind.takes:
            wanted = " or ".join(f'"{name}"' for name, other in built_in().items() if option in other.takes)
            raise InputError(
                f'--{option.replace("_", "-")}: is for backend.kind = {wanted}; this profile\'s is "{kind.name}"'
            )
    backend: Backend = pkgutil.resolve_name(kind.opener)(profile, options)
    table = profile.backend
    return gated(backend, profile, table) if isinstance(table, CardOptions) else backend
