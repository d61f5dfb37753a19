"""The table ``[stake]`` of a profile: what a named cause predicts of its ramp, written before that is run.

A recording holds its profile's text, so that a run that was staked on carries its own prediction.
"""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from daq.setup.strict_toml import parse_toml
from daq.setup.values import Frozen


class StakedParameter(Frozen):
    """A parameter at which the prediction is made."""

    effect: str
    parameter: str
    value: float = Field(description="in its own unit; a run that is held against it moves it no more")
    cause: bool = Field(description="whether it is of a named cause; else of an instrument or a calibration")


class StakedStep(Frozen):
    """What is predicted of one step: the median of measured minus predicted landings, each one flight ahead.

    Its interval holds the noise of earlier runs; the later run is judged with its own noise in its place.
    """

    gamma: float = Field(ge=0)
    within_us: float = Field(gt=0, description="half the interval about zero in which that median lies")
    rival_us: float | None = Field(
        default=None, description="where it would lie, if the strongest rival were right; left out: it lands elsewhere"
    )
    declared_us: float | None = Field(default=None, description="the same, if nothing but what is declared acted")
    flight_ms: float = Field(gt=0, description="mean flight time expected; no test, as it hangs on how a motion began")


class Stake(Frozen):
    """A frozen prediction: of landings one flight ahead, from the event measured before, so that chaos is no loss."""

    named: tuple[str, ...] = Field(min_length=1, description="effects that the verdict named")
    rival: tuple[str, ...] = Field(description="the strongest other explanation; empty: nothing but what is declared")
    nats: float = Field(ge=0, description="by which the run would speak against what is named, if the rival is right")
    chance: float = Field(gt=0, lt=1, description="probability that right causes miss one of the intervals")
    software: str = Field(description="version and commit of the program that predicted")
    written: str = Field(description="when, ISO 8601; only a run that began later can meet it")
    recordings: tuple[str, ...] = Field(description="that the verdict is on")
    parameters: tuple[StakedParameter, ...] = Field(min_length=1, description="at which the prediction is made")
    covariance: tuple[tuple[float, ...], ...] = Field(
        description="of the parameters, each in the library's scale of it, in their order"
    )
    steps: tuple[StakedStep, ...] = Field(min_length=1, description="what is predicted of each step of the ramp")

    @model_validator(mode="after")
    def _square(self) -> Self:
        """Refuse a covariance of other parameters."""
        n = len(self.parameters)
        if [len(row) for row in self.covariance] != [n] * n:
            raise ValueError(f"covariance: expected {n} rows of {n} numbers, one for each of the parameters")
        return self


class _WithStake(Frozen, extra="ignore"):
    """A profile of which only the stake is asked for."""

    stake: Stake | None = None


def stake_in(profile_text: str, name: str) -> Stake | None:
    """The stake in a profile's text; ``name`` stands for the file in messages.

    Raises `daq.setup.errors.InputError` where the table does not fit.
    """
    return parse_toml(profile_text, _WithStake, name).stake
