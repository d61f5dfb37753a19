"""Kernels compiled by numba, and kept on disk under the hash of everything that they are made of.

numba's own cache looks at the file in which a function stands, not at the functions it calls, and so runs stale code
after an edit of one of those. Here the name of a kept kernel is a hash of its bytecode and constants and those of every
function it reaches (`kernels.fingerprint`), of the types it is called with and of the processor. The folder carries
the versions of numba, llvmlite, Python and this package.
"""

from __future__ import annotations

import gc
import hashlib
import io
import pickle
import sys
from collections.abc import Callable
from types import FunctionType
from typing import Any, cast

import numba
from numba.core import compiler, config, environment, event, runtime, serialize
from numba.core.caching import NullCache
from numba.extending import is_jitted

from kernels import folder
from kernels.compiler import KernelCompiler, for_callers
from kernels.fingerprint import fingerprint, fingerprint_of_closure

DIGEST_BYTES = 32
_CompileResult, _config, _serialize = cast(Any, compiler.CompileResult), cast(Any, config), cast(Any, serialize)
_runtime, _environment = cast(Any, runtime), cast(Any, environment)


def njit(**options: Any) -> Any:
    """Compile a function at its first call, and keep the machine code for later processes.

    Parameters
    ----------
    **options
        As `numba.njit` takes them; ``cache`` has no effect: it is always on.

    Returns
    -------
    callable
        The decorator, which gives numba's dispatcher.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        if isinstance(function, FunctionType) and function.__closure__:
            # the machine code of two of one name must not share a symbol
            function.__qualname__ = f"{function.__qualname__}_{fingerprint_of_closure(function)[:12]}"
        own = {"cache": False, "no_cfunc_wrapper": True, "pipeline_class": KernelCompiler}
        dispatcher = numba.njit(**{**options, **own})(function)
        if is_jitted(dispatcher):  # NUMBA_DISABLE_JIT leaves the function as it is
            cast(Any, dispatcher)._cache = KernelCache(dispatcher)
            for_callers(dispatcher, function, options)
        return dispatcher

    return compiled


class _NoOldGarbage(event.Listener):
    """Compiling makes millions of objects: the collector need not look again and again at all that was there before."""

    def __init__(self) -> None:
        self._deep, self._ours = 0, False

    def on_start(self, started: Any) -> None:
        """Set aside what is there when the outermost kernel begins, unless somebody has."""
        if self._deep == 0:
            self._ours = gc.get_freeze_count() == 0
            if self._ours:
                gc.freeze()
        self._deep += 1

    def on_end(self, ended: Any) -> None:
        """Take it back when that kernel is done."""
        self._deep -= 1
        if self._deep == 0 and self._ours:
            gc.unfreeze()


cast(Any, event).register("numba:compile", _NoOldGarbage())


class _Kept(pickle.Unpickler):
    """Reads a kept kernel without loading what numba knows of NumPy's functions."""

    def find_class(self, module: str, name: str) -> Any:
        """What stands under a name, but for `_environment_of` in the place of numba's own."""
        ours = (module, name) == ("numba.core.environment", "_rebuild_env")
        return _environment_of if ours else super().find_class(module, name)


def _environment_of(module: str, constants: list[Any], name: str) -> Any:
    """The Python objects that machine code may ask for: the constants of a function and the names of its module.

    Code that was compiled without the interpreter reads no names. numba imports the module for them all the same, and
    those of NumPy's functions import SciPy's linear algebra.
    """
    if not module.startswith("numba.np.") or module in sys.modules:
        return _environment._rebuild_env(module, constants, name)
    made = _environment.lookup_environment(name)
    if made is None:
        made = _environment.Environment._memo[name] = _environment.Environment({"__name__": module})
        made.env_name = name
        made.consts[:] = constants
    return made


class KernelCache(NullCache):
    """What numba asks for the kept machine code of one function, and hands new machine code to.

    Any number of processes may use it at once: a file is written whole under its final name or not at all, and its
    name fixes its content.
    """

    def __init__(self, dispatcher: Any) -> None:
        self._dispatcher = dispatcher

    @property
    def cache_path(self) -> str:
        """The folder in which kernels are looked for first."""
        return str(next(iter(folder.places()), ""))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The kept code for the argument types ``sig``; None when there is none.

        What numba knows of types and operators is loaded when something is compiled: kept code needs its memory alone.
        """
        _runtime.rtsys.initialize(target_context)
        data = folder.read(self._name(sig, target_context.codegen()))
        if data is None or hashlib.sha256(data[DIGEST_BYTES:]).digest() != data[:DIGEST_BYTES]:
            return None  # a damaged file is compiled anew, and written over
        return _CompileResult._rebuild(target_context, *_Kept(io.BytesIO(data[DIGEST_BYTES:])).load())

    def save_overload(self, sig: Any, cres: Any) -> None:
        """Keep the code just compiled for ``sig``."""
        if cres.library.has_dynamic_globals or any(not lifted.can_cache for lifted in cres.lifted):
            return  # holds addresses of this process
        name = self._name(sig, cres.target_context.codegen())
        data: bytes = _serialize.dumps(cres._reduce())
        folder.write(name, hashlib.sha256(data).digest() + data)

    def _name(self, sig: Any, codegen: Any) -> str:
        """The file's name: the function's for a person, and the hash."""
        function = self._dispatcher.py_func
        made_of = (fingerprint(self._dispatcher), repr(sig), codegen.magic_tuple(), _config.BOUNDSCHECK)
        digest = hashlib.sha256(repr(made_of).encode()).hexdigest()[:32]
        return f"{function.__module__}.{function.__name__}-{digest}"
