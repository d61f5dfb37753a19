"""The decorator of kernels, and their machine code: taken from the folder by the hash of all it is made of, or built.

numba's own cache looks at the file in which a function stands, not at the functions it calls, and so runs stale code
after an edit of one of those. Here a stored kernel's name is a hash of its bytecode and constants and those of every
function it reaches (`kernels.folder`), of the kinds of its arguments, of the processor, of numba's settings in the
environment and of the sources of this package `kernels`. The folder carries the versions of numba, llvmlite, Python
and shakerbench. Any number of processes may use it at once: a file is written whole under its final name or not at
all, and its name fixes its content.
"""

from __future__ import annotations

import functools
import hashlib
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from kernels import folder
from kernels.folder import fingerprint, fingerprint_of_sources
from kernels.kernel import Function, Kernel, Kind, text

DIGEST_BYTES = 32
_one_at_a_time = threading.RLock()


def njit(**options: Any) -> Callable[[Function], Any]:
    """Compile a function at its first call, and keep the machine code for later processes.

    Returns the decorator, which gives a `Kernel`; with ``NUMBA_DISABLE_JIT`` set, the function as it is.

    Parameters
    ----------
    **options
        As `numba.njit` takes them; ``cache`` has no effect: it is always on.
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return lambda function: function
    return lambda function: Kernel(function, options, machine_code_of)


def machine_code_of(kernel: Kernel, kinds: tuple[Kind, ...], arguments: tuple[Any, ...]) -> Function:
    """What runs ``kernel`` for arguments of the given kinds, of which ``arguments`` are an example."""
    from kernels import machine_code  # an import of the program needs nothing of it

    with _one_at_a_time:
        name = _name(kernel, kinds)
        data = folder.read(name)
        code = None
        if data is not None and hashlib.sha256(data[DIGEST_BYTES:]).digest() == data[:DIGEST_BYTES]:
            code = machine_code.load(data[DIGEST_BYTES:])
        if code is None:  # not there, or damaged: it is written over
            from kernels import building  # imports numba

            code, stored = building.build(kernel, arguments)
            if stored is not None:
                folder.write(name, hashlib.sha256(stored).digest() + stored)
        return code


def _name(kernel: Kernel, kinds: tuple[Kind, ...]) -> str:
    """The file's name: the function's for a person, and the hash."""
    # numba's settings change what a kernel compiles to, but for the one that names the folder
    numba = sorted(item for item in os.environ.items() if item[0].startswith("NUMBA_") and item[0] != folder.GIVEN)
    made_of = repr((fingerprint(kernel), text(kinds), (*_machine(), numba)))
    return f"{kernel.py_func.__module__}.{kernel.py_func.__name__}-{hashlib.sha256(made_of.encode()).hexdigest()[:32]}"


@functools.cache
def _machine() -> tuple[str, ...]:
    """The processor, and the hash of the sources that compile."""
    from llvmlite import binding

    paths = sorted(Path(__file__).parent.rglob("*.py"))
    own = fingerprint_of_sources(path.read_text(encoding="utf-8") for path in paths)
    features = binding.get_host_cpu_features().flatten()
    return binding.get_process_triple(), binding.get_host_cpu_name(), features, own
