"""Options common to all back ends, the record by which a kind registers itself, and the kinds that are known.

Known are those of this folder, and those that installed packages offer as entry points of the group
``shakerbench.backends``: its name is the kind, its value leads to a `BackendKind`. It is loaded when a profile asks for
that kind. A kind of this folder cannot be replaced.
"""

from __future__ import annotations

import functools
import importlib
import pkgutil
from collections.abc import Mapping
from dataclasses import dataclass, fields
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationError, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

import rig.backends.kinds
from daq.setup.errors import InputError
from daq.setup.values import Frozen

GROUP = "shakerbench.backends"
DEFAULT = "simulated"


class BackendOptions(Frozen):
    """The ``[backend]`` table of a profile; a kind adds its own keys, and ``kind`` as a `Literal` of its name."""

    required: ClassVar[tuple[str, ...]] = ()
    """Keys by which a device is chosen; an empty one is refused."""

    kind: str
    block_samples: int = Field(default=1024, ge=16, le=65536, description="largest block exchanged at once")
    marker_v: float = Field(default=0.1, gt=0, description="height of the chirp that finds the loop-back at the start")

    @model_validator(mode="after")
    def _named(self) -> Self:
        """Refuse a table that does not name its device."""
        for key in self.required:
            if not getattr(self, key):
                raise ValueError(f"{key}: missing; a {self.kind} is chosen by name; `bench devices` lists them")
        return self


@dataclass(frozen=True)
class OpenOptions:
    """Options of one run, from the command line; a back end that does not take one is refused where it is given."""

    scenario: Path | None = None  # file of the hidden truth of a simulated rig
    seed: int = 0  # of a simulated rig's noise; any back end may be given one
    real_time: bool = False  # whether a simulated rig is paced to the clock
    replay: Path | None = None  # recording that a replay plays

    def given(self) -> list[str]:
        """Names of the options that differ from their defaults, the seed left out."""
        return [f.name for f in fields(self) if f.name != "seed" and getattr(self, f.name) != f.default]


@dataclass(frozen=True)
class BackendKind:
    """A kind of back end."""

    options: type[BackendOptions]  # model of its ``[backend]`` table
    # ``module:function`` of the function ``(profile, OpenOptions) -> Backend``; imported when a back end is
    # opened. It raises `daq.setup.errors.InputError` for what it cannot be opened with.
    opener: str
    takes: frozenset[str] = frozenset()  # names of the `OpenOptions` that it heeds

    @property
    def name(self) -> str:
        """The kind, as ``[backend] kind`` has it: the one value of the model's ``kind``."""
        return str(self.options.model_fields["kind"].default)


@functools.cache
def built_in() -> Mapping[str, BackendKind]:
    """Kinds of this folder by name, the default first: each module that has a ``BACKEND``."""
    path = rig.backends.kinds.__path__
    modules = [importlib.import_module(f"{rig.backends.kinds.__name__}.{m.name}") for m in pkgutil.iter_modules(path)]
    kinds = [m.BACKEND for m in modules if hasattr(m, "BACKEND")]
    return {kind.name: kind for kind in sorted(kinds, key=lambda kind: (kind.name != DEFAULT, kind.name))}


def offered() -> Mapping[str, EntryPoint]:
    """Entry points of installed packages by kind, built-in names left out."""
    return {e.name: e for e in entry_points(group=GROUP) if e.name not in built_in()}


def names() -> list[str]:
    """Every kind that a profile may ask for, the built-in ones first."""
    return [*built_in(), *sorted(offered())]


def _listed() -> str:
    """Every kind, for an error."""
    *first, last = map(repr, names())
    return f"{', '.join(first)} or {last}"


def kind_of(name: str) -> BackendKind:
    """The kind called ``name``.

    Raises `InputError` when there is none, or the package that offers it does not load or offers something else.
    """
    if name in built_in():
        return built_in()[name]
    entry = offered().get(name)
    if entry is None:
        raise InputError(f"backend.kind: wanted {_listed()}, came {name!r}")
    package = entry.dist.name if entry.dist is not None else entry.value
    try:
        kind = entry.load()
    except (ImportError, AttributeError) as error:
        raise InputError(f"backend.kind: {name!r} of package {package} does not load: {error}") from error
    if not isinstance(kind, BackendKind) or kind.name != name:
        raise InputError(f"backend.kind: {name!r} of package {package}: {entry.value} is no BackendKind of that name")
    return kind


def _checked(value: Any) -> BackendOptions:
    """The options of the kind that a table names; raises `ValidationError` with the place of each fault."""
    if isinstance(value, BackendOptions):
        return value
    if not isinstance(value, Mapping):
        raise PydanticCustomError("dict_type", "wanted a table")
    name = value.get("kind", DEFAULT)
    # installed packages are looked through only for a kind that is none of ours: that takes longer than all else
    if not isinstance(name, str) or (name not in built_in() and name not in offered()):
        raise _faults(InitErrorDetails(type="literal_error", loc=("kind",), input=name, ctx={"expected": _listed()}))
    try:
        options = kind_of(name).options
    except InputError as error:
        raise ValueError(str(error)) from error
    others = [
        (key, [owner for owner, kind in built_in().items() if key in kind.options.model_fields])
        for key in value
        if key not in options.model_fields
    ]
    misplaced = [
        InitErrorDetails(
            type=PydanticCustomError(
                "value_error",
                "{error}",
                {"error": f"is for backend.kind = {' or '.join(map(repr, owners))}; this profile's is {name!r}"},
            ),
            loc=(key,),
            input=value[key],
        )
        for key, owners in others
        if owners
    ]
    if misplaced:
        raise _faults(*misplaced)
    return options.model_validate(value, strict=True)


def _faults(*faults: InitErrorDetails) -> ValidationError:
    return ValidationError.from_exception_data("backend", list(faults))


class _ByKind:
    """Annotation of a field that is checked by the options model of the kind that its table names."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """One function for all kinds, so that a kind is loaded only when it is asked for."""
        return core_schema.no_info_plain_validator_function(_checked)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """The built-in kinds side by side, for editors."""
        return {"anyOf": [handler(kind.options.__pydantic_core_schema__) for kind in built_in().values()]}


OptionsByKind = Annotated[BackendOptions, _ByKind()]
"""Type of a profile's ``backend``."""
