"""Kernels as other kernels call them: linked into the caller, and made machine code only there.

numba makes every function that it meets ready to be called from Python: it optimises it alone, emits its machine code
and a wrapper that unpacks Python objects, and then does all of it again for the function that calls it. Here a kernel
that is called from a kernel is compiled a second way, without any of that; the caller optimises the whole at once.
"""

# numba's inner parts carry no types
# mypy: disable-error-code="no-untyped-call,misc"
from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numba
from numba.core import codegen, compiler, compiler_machinery, types, untyped_passes

_Library: Any = codegen.JITCodeLibrary
_Compiler: Any = compiler.CompilerBase
_Pass: Any = compiler_machinery.FunctionPass


def for_callers(dispatcher: Any, function: Callable[..., Any], options: dict[str, Any]) -> None:
    """Let kernels that call ``dispatcher`` link the code of ``function``, compiled for them alone."""

    @functools.cache
    def linked() -> Any:
        bare = {**options, "cache": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        return numba.njit(**bare, pipeline_class=_LinkedCompiler)(function)

    def call_template(args: Any, kws: Any) -> Any:
        plain = {name: types.unliteral(given) for name, given in kws.items()}  # not anew for each constant
        return linked().get_call_template([types.unliteral(given) for given in args], plain)

    dispatcher.get_call_template = call_template
    dispatcher.get_overload = lambda sig: linked().get_overload(sig)


class _NoEnvironment:
    """What stands for the code generator where there is no code: compiled functions need no Python environment."""

    @staticmethod
    def set_env(name: str, environment: Any) -> None:
        """Ignore the environment."""


class _LinkedLibrary(_Library):
    """Code of one function that is only linked into others."""

    codegen = _NoEnvironment

    def _optimize_functions(self, module: Any) -> None:
        """Leave it to the libraries that it is linked into."""
        module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        """Leave it to the libraries that it is linked into."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """No machine code, no address."""
        self._ensure_finalized()
        return 0


@compiler_machinery.register_pass(mutates_CFG=False, analysis_only=False)
class _LinkOnly(_Pass):
    """Choose the library before the code is generated."""

    _name = "link_only"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        """Give the function a library that is only linked."""
        state.library = _LinkedLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        return True


class _LinkedCompiler(_Compiler):
    """numba's passes, and the choice of the library."""

    def define_pipelines(self) -> list[Any]:
        """One pipeline: that of every compiled function with `_LinkOnly` in it."""
        passes = compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_LinkOnly, untyped_passes.TranslateByteCode)
        passes.finalize()
        return [passes]
