"""Compilation of kernels and of those that they call: as numba does it, without what is not needed.

numba makes every function that it meets ready to be called from Python: it optimises it, emits its machine code and a
wrapper that unpacks Python objects, and then does all of it again for the function that calls it. Here a kernel
that is called from a kernel is compiled a second way, without any of that; the kernel that Python calls links all that
is below it once, and optimises the whole at once. Where a called kernel makes no array and returns none, no references
are counted in it.
"""

# numba's inner parts carry no types
# mypy: disable-error-code="no-untyped-call,misc"
from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numba
from numba.core import codegen, compiler, compiler_machinery, ir, typed_passes, types, untyped_passes

_Library: Any = codegen.JITCodeLibrary
_Compiler: Any = compiler.CompilerBase
_Pass: Any = compiler_machinery.FunctionPass


def for_callers(dispatcher: Any, function: Callable[..., Any], options: dict[str, Any]) -> None:
    """Let kernels that call ``dispatcher`` link the code of ``function``, compiled for them."""

    @functools.cache
    def linked() -> Any:
        bare = {**options, "cache": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        return numba.njit(**bare, pipeline_class=_LinkedCompiler)(function)

    def call_template(args: Any, kws: Any) -> Any:
        plain = {name: types.unliteral(given) for name, given in kws.items()}  # not anew for each constant
        return linked().get_call_template([types.unliteral(given) for given in args], plain)

    dispatcher.get_call_template = call_template
    dispatcher.get_overload = lambda sig: linked().get_overload(sig)


class _KernelLibrary(_Library):
    """Code of a kernel, with that of all kernels below it."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.enable_object_caching()  # before there is code

    def add_linking_library(self, library: Any) -> None:
        """Link ``library`` and what it left to be linked here."""
        super().add_linking_library(library)
        if isinstance(library, _LinkedLibrary):
            for below in library.left:
                if below not in self._linking_libraries:
                    self.add_linking_library(below)


class _NoEnvironment:
    """What stands for the code generator where there is no code: compiled functions need no Python environment."""

    @staticmethod
    def set_env(name: str, environment: Any) -> None:
        """Ignore the environment."""


class _LinkedLibrary(_Library):
    """Code of one function that is only linked into others; the functions that it calls are linked there as well."""

    codegen = _NoEnvironment

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.left: list[Any] = []

    def add_linking_library(self, library: Any) -> None:
        """Leave ``library`` to the kernel."""
        library._ensure_finalized()
        self._reload_init.update(library._reload_init)
        self.left.append(library)

    def _optimize_functions(self, module: Any) -> None:
        """Leave it to the kernel."""
        module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        """Nothing is linked, optimised or emitted."""
        self._raise_if_finalized()
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """No machine code, no address."""
        self._ensure_finalized()
        return 0


@compiler_machinery.register_pass(mutates_CFG=False, analysis_only=False)
class _ChooseLibrary(_Pass):
    """Choose the library before the code is generated."""

    _name = "choose_library"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        """Give the function the library of its compiler."""
        state.library = state.pipeline.library(state.targetctx.codegen(), state.func_id.func_qualname)
        return True


UNCOUNTED = frozenset({"build_tuple", "cast", "exhaust_iter", "getattr", "getitem", "static_getitem"})
"""What gives an array that somebody holds already."""


@compiler_machinery.register_pass(mutates_CFG=False, analysis_only=False)
class _LendArrays(_Pass):
    """Count no references in a function that makes no array and returns none: its caller holds all that it is given."""

    _name = "lend_arrays"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        """Take the counting out of the code to be generated."""
        if _only_borrows(state):
            state.targetctx = state.targetctx.subtarget(enable_nrt=False, cached_internal_func={})
        return True


def _only_borrows(state: Any) -> bool:
    """Whether a function with known types holds nothing that its caller does not hold."""
    models = state.targetctx.data_model_manager

    def held(typed: Any) -> bool:
        return bool(models[typed].contains_nrt_meminfo())

    def borrows(made: Any, value: Any) -> bool:
        if not isinstance(value, ir.Expr):
            return True
        if value.op == "getitem" and held(state.typemap[value.index.name]):
            return False  # a new array
        if value.op != "call":
            return value.op in UNCOUNTED or not held(made)
        called, given = state.typemap[value.func.name], [state.typemap[v.name] for v in value.list_vars()[1:]]
        if isinstance(called, types.Dispatcher):
            return not held(made)
        own = isinstance(called, types.NamedTupleClass) or getattr(called, "typing_key", None) is len
        return own or not (held(made) or any(held(each) for each in given))

    if held(state.return_type):
        return False
    for block in state.func_ir.blocks.values():
        for statement in block.body:
            if isinstance(statement, ir.Assign):
                if not borrows(state.typemap[statement.target.name], statement.value):
                    return False
            elif isinstance(statement, ir.SetItem | ir.StaticSetItem) and held(state.typemap[statement.value.name]):
                return False
    return True


class KernelCompiler(_Compiler):
    """numba's passes, with the choice of a library: for a kernel called from Python."""

    library: type = _KernelLibrary

    def define_pipelines(self) -> list[Any]:
        """One pipeline: that of every compiled function with `_ChooseLibrary` in it."""
        passes = compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_ChooseLibrary, untyped_passes.TranslateByteCode)
        passes.finalize()
        return [passes]


class _LinkedCompiler(KernelCompiler):
    """The same for a kernel called from a kernel."""

    library = _LinkedLibrary

    def define_pipelines(self) -> list[Any]:
        """The same passes, and `_LendArrays`."""
        (passes,) = super().define_pipelines()
        passes.add_pass_after(_LendArrays, typed_passes.NopythonTypeInference)
        passes.finalize()
        return [passes]
