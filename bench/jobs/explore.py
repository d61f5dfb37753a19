"""A rig that chooses its own steps: block by block, until one explanation stands or the time is spent.

Each block is a short ramp of its own, planned, limited, driven and recorded as any other; the analysis reads only
recordings. Why its steps were chosen is noted in the recording.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from analysis.attribution.candidates import null_value_of, parameter_of, priors_of
from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import Hypothesis
from analysis.attribution.selection import StepwiseSelection
from analysis.explore.choice import Block, Option, Pool, best_block, bistable, limits_of, sharpest
from analysis.explore.explanations import Weighed, weighed
from analysis.explore.stake import Outcome, with_outcome
from analysis.loop.close_loop import FittedLoop, completed, judge_loop
from analysis.loop.result import ClosedLoop
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.observations import Observations, observations_from
from analysis.residuals.values import ParameterId
from analysis.thresholds import FROZEN
from bench.jobs.blocks import (
    LEAST_STEPS,
    Aims,
    Chosen,
    Driven,
    as_driven,
    block_text,
    by_person,
    chosen,
    offers,
    outcome_of,
    staked_block,
    tells,
)
from daq.instrument.instrument import refuse_doubtful
from daq.setup.errors import InputError
from daq.setup.setup import Stake, stake_in
from model.effects.registry import resolve
from rig.profile import parse_profile


@dataclass(frozen=True)
class Explored:
    """Outcome of a run that chose its steps."""

    recordings: tuple[Path, ...]  # one for each block
    blocks: tuple[Chosen, ...]
    loop: ClosedLoop | None  # the closed loop on all of them; None where there are too few steps for a verdict
    rig_s: float  # rig time
    why: str  # why it ended
    failed: bool = False  # whether a block could not be completed


Drive = Callable[[Chosen, Path, int], Driven]
"""Drives and records a block."""
Asked = Callable[[Chosen], Chosen | None]
"""A person's answer to a choice: the same, another one, or None to stop."""


def explore(
    text: str, folder: Path, aims: Aims, drive: Drive, *, say: Callable[[str], None], ask: Asked | None = None,
    anyway: bool = False,
) -> Explored:  # fmt: skip
    """Choose, drive and judge blocks until an aim is reached (raises `InputError`).

    ``text`` is the profile (TOML). ``folder`` is for ``block-01.h5`` and on; blocks there are taken as driven, but for
    one stopped too early to tell anything. ``drive`` drives a block; ``ask`` is asked before each (None: go on
    unasked); ``say`` is called with each choice and what came of it. With ``anyway`` recordings that contradict the
    profile are judged, too.
    """
    offered = functools.cache(lambda hold_cycles: offers(text, replace(aims, hold_cycles=hold_cycles)))
    offered(aims.hold_cycles)  # what cannot be driven is refused before anything is judged
    made, number = _recorded(folder, say)
    blocks = [as_driven(path) for path in made]
    known: dict[Path, Observations] = {}
    judged: _Judged | None = None
    last: _HeldStake | None = None

    def ended(why: str, *, failed: bool = False) -> Explored:
        loop = None if judged is None else judged.completed(last)
        return Explored(tuple(made), tuple(blocks), loop, sum(block.seconds for block in blocks), why, failed)

    own: Chosen | None = None
    while True:
        if own is None:
            last = _last_stake(made, known)
            if last is not None and last.run == made[-1]:
                if last.outcome.met:
                    judged = judged or _judge(made[:-1], known, anyway=anyway)
                    return ended(f"{' + '.join(last.stake.named)} explains everything, and met what was staked on it")
                say(last.outcome.words)
            judged = _judge(made, known, anyway=anyway) if made else None
            own, why = _next(text, judged, blocks, offered, aims)
            if own is None:
                own, why = _stake(text, judged, made, blocks, offered, aims, why)
            if own is None:
                return ended(why)
            say(f"\nblock {number + 1}: {own.reason}")
            if ask is not None and (own := ask(own)) is None:
                return ended("a person stopped it")
        number += 1
        path, block, own = folder / f"block-{number:02d}.h5", own, None
        driven = drive(block, path, number - 1)
        if driven.why and driven.then is None:
            return ended(f"block {number}: {driven.why}", failed=True)
        if tells(path):
            made.append(path)
            blocks.append(replace(block, seconds=as_driven(path).seconds))
        else:
            say(f"stopped before {LEAST_STEPS} steps were held, and left out: {path.name}")
        if driven.then is not None and driven.then.gammas:
            own = by_person(block, driven.then)
            say(f"\nblock {number + 1}: {own.reason}")


def _recorded(folder: Path, say: Callable[[str], None]) -> tuple[list[Path], int]:
    """Blocks in the folder that tell something, in order, and the number of the last of all."""
    there = sorted(path for path in folder.glob("block-*.h5") if path.stem[6:].isdigit())
    made = [path for path in there if tells(path)]
    if left_out := [path.name for path in there if path not in made]:
        say(f"stopped before {LEAST_STEPS} steps were held, and left out: {', '.join(left_out)}")
    return made, max((int(path.stem[6:]) for path in there), default=0)


# -- what was found so far ---------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Judged:
    """The fits on all blocks so far, and the verdict; ``loop`` is None with too few steps."""

    fitted: FittedLoop
    loop: ClosedLoop | None = None

    def completed(self, last: _HeldStake | None) -> ClosedLoop | None:
        """The closed loop with a discovered term; ``last``, what was staked last, withdraws a verdict if not met."""
        if (loop := self.loop) is None:
            return None
        if last is not None and last.stake.named == loop.selection.names:
            loop = with_outcome(loop, last.outcome, last.run.name)
        return completed(loop, self.fitted)


def _judge(made: Sequence[Path], known: dict[Path, Observations], *, anyway: bool) -> _Judged:
    """The closed loop on all blocks; with fewer steps than a verdict needs, only the best set."""
    if not anyway:
        refuse_doubtful([path for path in made if path not in known])
    observations = observations_from(made, known=known)
    if len(observations.steps) < 2 * FROZEN.reserve_every:
        model = ForwardModel(observations, resolve(observations.setup.declared_values()))
        fitter = Fitter(model, priors_of(observations.setup), np.ones(len(observations.steps), dtype=bool))
        return _Judged(FittedLoop(model, StepwiseSelection(model, fitter).run()))
    loop, fitted = judge_loop(made, known=known, anyway=anyway)
    return _Judged(fitted, loop)


@dataclass(frozen=True)
class _HeldStake:
    """A prediction, the run that it was staked on, and what came of it."""

    stake: Stake
    run: Path
    outcome: Outcome


def _last_stake(made: Sequence[Path], known: dict[Path, Observations]) -> _HeldStake | None:
    """The last stake that was driven to its end."""
    for path in reversed(made):
        text = as_driven(path).text
        if (stake := stake_in(text, str(path))) is not None:
            with contextlib.suppress(InputError):  # a person ended it
                return _HeldStake(stake, path, outcome_of(stake, text, path, known))
    return None


def _stake(
    text: str, judged: _Judged | None, made: Sequence[Path], blocks: Sequence[Chosen],
    offered: Callable[[int], Sequence[Option]], aims: Aims, why: str,
) -> tuple[Chosen | None, str]:  # fmt: skip
    """The last block, on which an explanation is staked; or why there is none. The others are as in `_next`."""
    if judged is None or judged.loop is None or judged.loop.verdict != "explained":
        return None, why
    left_s = aims.budget_s - sum(block.seconds for block in blocks)
    block = staked_block(text, judged.fitted, offered(aims.hold_cycles), replace(aims, budget_s=left_s), made)
    if block is None:
        return None, f"{why}; nothing that the rig may drive would put it to the test"
    if block.seconds > left_s:
        return None, f"{why}; the rig time left is too short to stake it on a block"
    return block, why


# -- what to drive next ------------------------------------------------------------------------------------------------
def _next(
    text: str, judged: _Judged | None, blocks: Sequence[Chosen], offered: Callable[[int], Sequence[Option]], aims: Aims
) -> tuple[Chosen | None, str]:
    """The next block; or why there is none. ``offered`` gives the options by the cycles for which steps are held."""
    aims = _held(aims, None if judged is None else judged.loop)
    options = offered(aims.hold_cycles)
    if judged is None:
        return _farthest(text, options, (), aims, "nothing is known yet"), ""
    if (loop := judged.loop) is None:
        return _farthest(text, options, blocks, aims, "too few steps for a verdict yet"), ""
    model, best, ties = judged.fitted.model, judged.fitted.selection.best, judged.fitted.selection.ties
    fitter = best.fitter
    known = weighed(model, fitter, best, ties)
    hidden = _not_shown(loop, aims, known) if loop.verdict == "nothing_missing" else {}
    if loop.verdict == "explained" and len(loop.selection.ties) < 2 and not _loose(best, aims):
        return None, f"{' + '.join(loop.selection.names)} explains everything"
    if loop.verdict == "nothing_missing" and not hidden:
        return None, "nothing is missing, down to the sizes asked for"
    if loop.verdict == "explained":  # only what explains as much is left to be distinguished
        known = known.among([best.names, *(rival.names for rival in ties)])
    wanted = [key for key in aims.until if key in best.free]
    pools = [Pool.of(option, model, fitter, known) for option in options]
    left_s = aims.budget_s - sum(block.seconds for block in blocks)
    if hidden:
        wanted = _can_be_shown(hidden, pools, known, left_s)
        if not wanted:
            return None, f"nothing is missing; the time left would not show a smaller {_in_list(hidden)}"
    if why := _as_sharp_as_can_be(loop, best, aims, pools, known):
        return None, why
    block = best_block(pools, known, wanted, aims.steps)
    # a block that says less is not worth its time
    worth = block is not None and (block.nats >= 0.2 or block.sharpening > 0.5)
    if block is not None and worth and (block.sharpening > 0.5 or not _in_vain(block, blocks)):
        following = _chosen(text, block.option, block.gammas, aims, _in_words(block, pools, wanted))
    elif worth:
        following = _farthest(text, options, blocks, aims, "what seems to tell most was driven before and did not")
    elif loop.verdict == "explained" and len(loop.selection.ties) > 1:
        others = ", ".join(" + ".join(names) for names in loop.selection.ties[1:])
        return None, f"{' + '.join(loop.selection.names)} explains everything; no block would tell it from {others}"
    else:
        following = _farthest(text, options, blocks, aims, "no known explanation is left to be tested")
    if following.seconds > left_s:
        return None, f"the budget of {aims.budget_s:.1f} s of rig time is spent"
    return following, ""


def _held(aims: Aims, loop: ClosedLoop | None) -> Aims:
    """With longer steps where what was recorded so far is unexplained."""
    if loop is None or loop.verdict != "unexplained":
        return aims
    # longer holds separate tones as near as the mains and a harmonic
    return replace(aims, hold_cycles=2 * aims.hold_cycles)


def _in_vain(block: Block, blocks: Sequence[Chosen]) -> bool:
    """Whether the same steps were driven before: what they were to distinguish, they did not."""
    profiles = [parse_profile(driven.text, "block") for driven in blocks]
    before = [(p.forcing.ratio, p.forcing.frequency_hz, set(p.ramp.gammas())) for p in profiles]
    forcing = block.option.setup.forcing
    return (forcing.ratio, forcing.frequency_hz, set(block.gammas)) in before


def _in_words(block: Block, pools: Sequence[Pool], wanted: Sequence[ParameterId]) -> str:
    """Why a block was chosen."""
    a, b = (" + ".join(names) or "the declared model" for names in block.separates)
    about = f"about {a} or {b}" if block.sharpening < 0.5 else f"about the size of {_in_list(wanted)}"
    words = f"{block.nats:.2g} nats in {block.seconds:.1f} s of rig time, above all {about}"
    if twice := bistable(pools, block):
        side = "below" if block.option.rising else "above"
        words += f"; at gamma = {', '.join(f'{g:g}' for g in twice)} two motions exist, this one comes from {side}"
    return words


def _not_shown(loop: ClosedLoop, aims: Aims, known: Weighed) -> dict[ParameterId, float]:
    """Detection limits above what is asked for, as multiples of it.

    An effect that is more probable than all else together, and not named yet, is to be shown at its own size, with
    twice the evidence at least that there is now: a verdict asks for more than probability.
    """
    limits = {(name.partition(".")[0], name.partition(".")[2]): size for name, size in loop.detection.sizes.items()}
    over = {key: size / (aims.limit * parameter_of(key).scale) for key, size in limits.items()}
    first = known.explanations[0]
    if first.names != loop.selection.names and first.probability > 0.5:
        for key in set(first.free) & set(limits):
            own = abs(first.values[key] - null_value_of(key))
            over[key] = max(limits[key] / own if own else 0.0, 2.0 ** (0.5 * parameter_of(key).power))
    return {key: multiple for key, multiple in over.items() if multiple > 1.0}


def _can_be_shown(
    hidden: Mapping[ParameterId, float], pools: Sequence[Pool], known: Weighed, left_s: float
) -> list[ParameterId]:
    """Of detection limits above what is asked for, those that the rig time left would bring down to it."""
    return [
        key
        for key, multiple in hidden.items()
        if key in known.keys and multiple * sharpest(pools, known, key, left_s) ** parameter_of(key).power <= 1.0
    ]


def _in_list(keys: Iterable[ParameterId]) -> str:
    """Parameters in words."""
    return ", ".join(map(".".join, keys))


def _loose(best: Hypothesis, aims: Aims) -> list[ParameterId]:
    """Parameters that are not yet as sharp as asked for."""
    return [key for key, sigma in aims.until.items() if key in best.free and best.fitted.sigma(key) > sigma]


def _as_sharp_as_can_be(loop: ClosedLoop, best: Hypothesis, aims: Aims, pools: Sequence[Pool], known: Weighed) -> str:
    """Why no step would make the parameters as sharp as asked for, or an empty text."""
    if loop.verdict != "explained" or len(loop.selection.ties) > 1:
        return ""
    for key in _loose(best, aims):
        share, limiting = limits_of(pools, known, key)
        sigma = best.fitted.sigma(key)
        if share * sigma > aims.until[key] and limiting:
            first = " or ".join(f"{name}.{q}" for name, q in limiting)
            return (
                f"{' + '.join(loop.selection.names)} explains everything; {'.'.join(key)} is known to {sigma:.2g}, and "
                f"no number of steps would bring it below {share * sigma:.2g}: calibrate {first} better, or ask "
                "for less"
            )
    return ""


def _chosen(text: str, option: Option, gammas: Sequence[float], aims: Aims, reason: str) -> Chosen:
    """A block in words: what is driven, and why."""
    forcing = option.setup.forcing
    return chosen(block_text(text, aims, forcing.ratio, forcing.frequency_hz, gammas), reason)


def _farthest(text: str, options: Sequence[Option], blocks: Sequence[Chosen], aims: Aims, reason: str) -> Chosen:
    """Steps as far as can be from those driven, of the forcing with the fewest of them."""
    profiles = [parse_profile(block.text, "block") for block in blocks]
    visited = [(p.forcing.ratio, g) for p in profiles for g in p.ramp.gammas()]

    def driven(option: Option) -> list[float]:
        return [g for ratio, g in visited if ratio == option.setup.forcing.ratio]

    # up and down in turn: what drifts with time then changes the other way with gamma, as no compression does
    rising = len(blocks) % 2 == 0
    option = min((option for option in options if option.rising == rising), key=lambda x: len(driven(x)))
    near, gammas = driven(option), list[float]()
    if not near:
        places = np.linspace(1, len(option.gammas) - 2, aims.steps).round().astype(int)
        return _chosen(text, option, [option.gammas[i] for i in places], aims, f"{reason}: spread over the range")
    while len(gammas) < aims.steps:
        rest = [g for g in option.gammas if g not in gammas]
        gammas.append(max(rest, key=lambda g: min(abs(g - other) for other in (*near, *gammas))))
    return _chosen(
        text, option, sorted(gammas, reverse=not rising), aims, f"{reason}: as far as can be from the steps driven"
    )
