"""Compilation of a kernel that is not stored: numba is imported, and compiles it as `kernels.compiler` says.

`kernels.compiler` and the stored machine code stand on numba's private interfaces, which may change with any release.
They are used with the releases in `TESTED` only. With every other one numba compiles as it does for everybody: the
same numbers, but slower, and each process compiles anew.
"""

# numba's inner parts carry no types
# mypy: disable-error-code="no-untyped-call"
from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from types import FunctionType, ModuleType
from typing import Any, cast

import numba
from numba.core import event, registry, runtime, serialize, types
from numba.extending import typeof_impl

from kernels.emit import lanes
from kernels.folder import fingerprint_of_closure
from kernels.kernel import Kernel, watchers
from kernels.lanes import Intrinsic
from kernels.machine_code import StoredKernel

TESTED = (0, 63), (0, 69)
"""numba's releases whose private interfaces were tried: from the first, up to and without the second."""


@functools.cache
def private_interfaces() -> ModuleType | None:
    """`kernels.compiler`; None where numba's release is not one of `TESTED`."""
    release = tuple(int(part) for part in numba.__version__.split(".")[:2])
    return importlib.import_module("kernels.compiler") if TESTED[0] <= release < TESTED[1] else None


def build(kernel: Kernel, arguments: tuple[Any, ...]) -> tuple[Callable[..., Any], bytes | None]:
    """Compile ``kernel`` for the types of ``arguments``.

    Returns what runs it, and its pickled `kernels.machine_code.StoredKernel`; None where it holds addresses of this
    process, or numba's release is not one of `TESTED`.
    """
    dispatcher = dispatcher_of(kernel)
    if private_interfaces() is None:
        return dispatcher, None
    given = tuple(dispatcher.typeof_pyval(argument) for argument in arguments)
    code = dispatcher.compile(given)
    return code, _pickled(kernel.py_func.__name__, dispatcher.overloads[given])


@functools.cache
def dispatcher_of(kernel: Kernel) -> Any:
    """numba's own object for a kernel: for types in which kernels call each other, and for compiling."""
    function = kernel.py_func
    copy = FunctionType(function.__code__, function.__globals__, function.__name__, function.__defaults__,
                        function.__closure__)  # fmt: skip
    copy.__module__, copy.__qualname__ = function.__module__, function.__qualname__
    if function.__closure__:  # the machine code of two of one name must not share a symbol
        copy.__qualname__ += f"_{fingerprint_of_closure(cast(FunctionType, function))[:12]}"
    inner = private_interfaces()
    if inner is None:
        return numba.njit(**{**kernel.targetoptions, "cache": False})(copy)
    own = {"cache": False, "no_cfunc_wrapper": True, "pipeline_class": inner.KernelCompiler}
    dispatcher: Any = numba.njit(**{**kernel.targetoptions, **own})(copy)
    inner.for_callers(dispatcher, copy, kernel.targetoptions)
    return dispatcher


@typeof_impl.register(Kernel)
def _type_of_kernel(kernel: Kernel, context: object) -> Any:
    return types.Dispatcher(dispatcher_of(kernel))


@typeof_impl.register(Intrinsic)
def _type_of_intrinsic(intrinsic: Intrinsic, context: object) -> Any:
    return cast(Any, registry.cpu_target).typing_context.resolve_value_type(getattr(lanes, intrinsic.name))


def _pickled(name: str, result: Any) -> bytes | None:
    library, description = result.library, result.fndesc
    # addresses of this process, which mean nothing in another
    if library.has_dynamic_globals or result.lifted or result.reload_init:
        return None
    wanted, code = _declared(library._final_module), [library._get_compiled_object()]
    # parts of numba's memory management are LLVM's code themselves: they are stored with the kernel that needs them
    memory: Any = cast(Any, runtime).rtsys.library._final_module
    defined = {each.name for each in memory.functions if not each.is_declaration}
    if wanted & defined:
        code.append(library.codegen._tm.emit_object(memory))
        wanted = (wanted | _declared(memory)) - defined
    environments = {description.env_name: result.environment.consts}
    environments |= {each.env_name: each.consts for each in result._find_referenced_environments()}
    stored = StoredKernel(name, description.llvm_cpython_wrapper_name, code, sorted(wanted), environments)
    pickled: bytes = cast(Any, serialize).dumps(tuple(stored))
    return pickled


def _declared(module: Any) -> set[str]:
    """Symbols that a module of LLVM's code wants from elsewhere."""
    named = (each.name for each in (*module.functions, *module.global_variables) if each.is_declaration)
    return {name for name in named if not name.startswith("llvm.")}


class _Compiling(event.Listener):
    """Calls the watchers."""

    def on_start(self, started: Any) -> None:
        """Compiling begins."""
        for watcher in watchers:
            watcher.on_start(started.data["dispatcher"].py_func.__name__)

    def on_end(self, ended: Any) -> None:
        """It is done."""
        for watcher in watchers:
            watcher.on_end()


event.register("numba:compile", _Compiling())
