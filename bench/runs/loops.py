"""Verdicts of closed loops saved below the runs' folder (`bench.jobs.keep_verdict`)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analysis.loop.verdicts import VERDICTS, short_verdict
from daq.recording.subprocess_reader import in_subprocess

NORMAL_95 = 1.959964  # half width of a 95 % interval, in standard deviations


@dataclass(frozen=True)
class Quantity:
    """A value with its standard deviation (None: unknown) and unit; ``origin``: profile or verdict."""

    name: str
    value: float
    sigma: float | None
    unit: str
    origin: str


@dataclass(frozen=True)
class Loop:
    """A verdict on recordings, known by their identities.

    Attributes
    ----------
    identities
        Of the recordings it is about.
    verdict, summary
        ``explained``, ``unexplained`` or ``nothing_missing``; the same with the effects that were added.
    quantities
        Parameters of added effects, and calibrations as fitted.
    before_us, after_us, floor_us
        Rms error of held-out landings before and after, and what noise leaves.
    """

    identities: tuple[str, ...]
    verdict: str
    summary: str
    quantities: tuple[Quantity, ...]
    before_us: float | None
    after_us: float | None
    floor_us: float | None


def saved_loops(paths: Iterable[Path]) -> Iterator[tuple[Path, Loop | None]]:
    """The verdicts in files of `analysis.loop.storage.save_verdict`, read by another process, which may die of them."""
    left = [str(path) for path in paths]
    while left:
        answer = in_subprocess("bench.runs.loop_reader:look", left)
        if not answer.died:
            yield from ((Path(name), _loop(one)) for name, one in answer.value.items())
            return
        culprit = answer.at if answer.at in left else left[0]
        left.remove(culprit)
        yield Path(culprit), None


def _loop(answer: Any) -> Loop | None:
    """The verdict from its JSON; None for JSON of something else."""
    try:
        verdict = str(answer["verdict"])
        if verdict not in VERDICTS:
            return None
        identities = tuple(str(x) for x in answer["source_ids"] if x)
        names = [str(effect["name"]) for effect in answer["effects"]]
        others = len(answer["tie_set"]) - 1
        words = short_verdict(verdict) + (f": {', '.join(names)}" if names else "")
        errors = (answer["before"]["landing_rms_us"], answer["after"]["landing_rms_us"], answer["noise_floor_us"])
        return Loop(
            identities, verdict, words + (f" (or {others} other sets)" if others > 0 else ""),
            tuple(_quantities(answer)),
            *(None if x is None else float(x) for x in errors),
        )  # fmt: skip
    except (KeyError, TypeError, ValueError, AttributeError):
        return None


def _quantities(answer: Any) -> Iterator[Quantity]:
    """Fitted parameters of a verdict."""
    for effect in answer["effects"]:
        for parameter, x in effect["parameters"].items():
            if x["value"] is None:
                continue
            known = x["low"] is not None and x["high"] is not None
            sigma = (x["high"] - x["low"]) / (2.0 * NORMAL_95) if known else None
            yield _quantity(effect["name"], parameter, x["value"], sigma)
    for x in answer["calibrations"]:
        if x["value"] is not None:
            yield _quantity(x["effect"], x["parameter"], x["value"], x["sigma"])


def _quantity(effect: str, parameter: str, value: float, sigma: float | None) -> Quantity:
    return Quantity(f"{effect}.{parameter}", float(value), sigma, unit_of(effect, parameter), "verdict")


def unit_of(effect: str, parameter: str) -> str:
    """Unit of a parameter of the model; empty of one that it does not know."""
    from model.effects.registry import effect as named

    try:
        return next((p.unit for p in named(effect).effect.parameters if p.name == parameter), "")
    except (KeyError, ValueError):
        return ""
