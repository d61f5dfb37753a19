"""Stored machine code, loaded and called without numba.

numba's machine code of a kernel holds the function that Python calls: it reads the arguments, runs the kernel, makes
Python's values of the results and raises its errors. It wants three things around it: symbols of numba's C libraries
(arrays' memory, conversions), an environment (the constants that results are made with) for each function in it, and
a linker, LLVM's. The C libraries are Python extensions that need nothing of the package they lie in, which takes
longer to import than most kernels run.
"""

from __future__ import annotations

import atexit
import builtins
import ctypes
import functools
import importlib
import importlib.util
import pickle
import sys
from collections.abc import Callable
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from llvmlite import binding


class StoredKernel(NamedTuple):
    """A kernel as it is stored."""

    name: str
    entry: str
    """Symbol of the function that Python calls."""
    code: list[bytes]
    """Machine code as relocatable object files."""
    wanted: list[str]
    """Symbols that are not in it."""
    environments: dict[str, list[Any]]
    """Constants of each function in it, by symbol; the kernel's own come first."""


def load(data: bytes) -> Callable[..., Any] | None:
    """What runs a pickled `StoredKernel`; None where this process lacks a symbol, which would end it."""
    stored = StoredKernel(*pickle.loads(data))
    engine = _engine()
    if not all(binding.address_of_symbol(symbol) for symbol in stored.wanted):
        return None
    for code in stored.code:
        engine.add_object_file(binding.ObjectFileRef.from_data(code))
    engine.finalize_object()
    functions, own = _extension("_dynfunc"), None
    for symbol, constants in stored.environments.items():
        environment = functions.Environment({"__name__": stored.name})
        environment.consts[:] = constants
        _alive.append(environment)
        own = own or environment
        # the machine code finds each function's constants by a pointer that the linker leaves empty
        place = engine.get_global_value_address(symbol)
        if place:
            ctypes.c_void_p.from_address(place).value = id(environment)
    made: Callable[..., Any] = functions.make_function(
        sys.modules[__name__], stored.name, "A kernel.", engine.get_function_address(stored.entry), own, (engine,)
    )
    return made


_alive: list[Any] = []
"""What machine code points to."""


@functools.cache
def _engine() -> Any:
    """LLVM's linker, with the symbols of numba's C libraries and Python's exceptions."""
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    target = binding.Target.from_triple(binding.get_process_triple()).create_target_machine(jit=True)
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), target)
    _give_symbols()
    return engine


def _give_symbols() -> None:
    """Do what numba does when it is imported and first compiles; done twice, it changes nothing."""
    memory = _extension("_nrt_python", "core", "runtime")
    helpers = {**_extension("_helperlib").c_helpers, **_extension("_dynfunc").c_helpers}
    symbols = {f"numba_{name}": address for name, address in helpers.items()}
    symbols |= {name if name.startswith("_") else f"NRT_{name}": at for name, at in memory.c_helpers.items()}
    symbols |= {name: address for name, address in helpers.items() if name in C_MATH or name[:-1] in C_MATH}
    types = ((name, each) for name, each in vars(builtins).items() if isinstance(each, type))
    symbols |= {f"PyExc_{name}": id(each) for name, each in types if issubclass(each, BaseException)}
    symbols["_Py_NoneStruct"] = id(None)
    symbols["numba_unpickle"] = ctypes.cast(_unpickle, ctypes.c_void_p).value
    for name, address in symbols.items():
        binding.add_symbol(name, address)
    memory.memsys_use_cpython_allocator()
    atexit.register(memory.memsys_shutdown)


# fmt: off
C_MATH = frozenset((
    "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "ceil", "cos", "cosh", "exp", "expm1", "fabs", "floor",
    "fmod", "log", "log10", "log1p", "pow", "round", "sin", "sinh", "sqrt", "tan", "tanh", "trunc",
))
# fmt: on
"""Functions that numba takes from Python's C library, of which a process may have two."""


_unpickled: dict[tuple[int, bytes], Any] = {}


@ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p)
def _unpickle(address: int, size: int, digest: int) -> Any:
    """Objects pickled into machine code: errors and types of results."""
    key = address, ctypes.string_at(digest, 20)
    if key not in _unpickled:
        _unpickled[key] = pickle.loads(ctypes.string_at(address, size))
    return _unpickled[key]


def _extension(name: str, *folders: str) -> Any:
    """One of numba's extension modules without the rest of numba, under the name under which numba imports it."""
    full = ".".join(("numba", *folders, name))
    if full not in sys.modules:
        package = importlib.util.find_spec("numba")
        places = [str(Path(place, *folders)) for place in package.submodule_search_locations or ()] if package else []
        spec = PathFinder.find_spec(full, places)
        if spec is None or spec.loader is None:
            return importlib.import_module(full)
        module: ModuleType = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        sys.modules[full] = module
    return sys.modules[full]
