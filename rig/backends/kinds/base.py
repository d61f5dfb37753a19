"""Options common to all back ends, and the record by which a kind registers itself."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import ClassVar, Self

from pydantic import Field, model_validator

from daq.setup.values import Frozen


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
