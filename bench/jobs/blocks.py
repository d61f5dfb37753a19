"""Blocks of steps that a rig drives one after another (how one ended, which may be driven), and a verdict's stakes.

A block is a short ramp of its own, within the same limits as any other. A stake is written as a profile that can be
driven, and read again with the run that it was staked on.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from analysis.explore.choice import Option
from analysis.explore.stake import Outcome, held_against, staked, steps_of, with_outcome
from analysis.loop.close_loop import FittedLoop
from analysis.loop.result import ClosedLoop, is_verdict, load_verdict, save_verdict
from analysis.residuals.observations import Observations, observations_from
from analysis.residuals.values import ParameterId
from bench.jobs.loops import verdict_file
from bench.profiles.edit import toml_value, with_values
from bench.profiles.find import planned, refuse_forbidden
from daq.files.disk import write_whole
from daq.recording import open_recording
from daq.setup.clock import now_utc
from daq.setup.errors import InputError
from daq.setup.provenance import software_commit, software_version
from daq.setup.setup import Setup, Stake, stake_in
from daq.setup.values import read_toml_text
from rig.profile import Profile, parse_profile
from rig.programme.ramp import NextSteps, plan, stop_fade_samples

LEAST_STEPS = 2  # held, of a block that is gone on with


@dataclass(frozen=True)
class Aims:
    """When to stop, and what may be changed."""

    budget_s: float  # rig time
    until: Mapping[ParameterId, float] = field(default_factory=dict)  # standard deviation asked for
    limit: float = 1.0  # down to which "nothing missing" is to be shown, in units of the size that would matter
    ratios: tuple[int, ...] = (1, 2, 3)  # values of c that may be driven
    frequencies_hz: tuple[float, ...] = ()  # of the first tone, that may be driven
    steps: int = 4  # of each block
    hold_cycles: int = 14  # of each step
    settle_cycles: int = 4  # after each fade, for the plate; the ball need not settle, as flights are judged singly


@dataclass(frozen=True)
class Chosen:
    """A block to be driven: its profile as text, its rig time, and the reason in words."""

    text: str
    seconds: float
    reason: str


@dataclass(frozen=True)
class Driven:
    """The end of a block."""

    why: str = ""  # why it was not completed; empty where it was
    then: NextSteps | None = None  # what the person who ended it wants driven next; None where that is nothing more


def by_person(block: Chosen, wanted: NextSteps) -> Chosen:
    """The block with a person's steps; raises `InputError` where a limit forbids one."""
    ratio = {} if wanted.ratio is None else {"forcing.ratio": wanted.ratio}
    changes = _in_order(wanted.gammas) | ratio | {"stake": None}  # other steps are another prediction
    text = with_values(block.text, changes, "the block")
    refuse_forbidden("these gammas", parse_profile(text, "the block"))
    return chosen(text, f"chosen by a person{f', {wanted.why}' if wanted.why else ''}")


def chosen(text: str, why: str) -> Chosen:
    """The block with the profile ``text``; its reason says the forcing, and ``why``."""
    profile = parse_profile(text, "the block")
    forcing, gammas = profile.forcing, ", ".join(f"{g:g}" for g in profile.ramp.gammas())
    words = f"c = {forcing.ratio}, {forcing.frequency_hz:g} Hz, gamma {gammas}: {why}"
    return Chosen(text, run_seconds(profile), words)


def tells(path: Path) -> bool:
    """Whether enough steps of a block were held to their end."""
    with open_recording(path) as opened:
        steps = opened.steps
        whole = steps["first_sample"] + steps["n_samples"] <= opened.n_samples
        held = whole & (steps["settle_samples"] < steps["n_samples"])
        return int(np.count_nonzero(held)) >= LEAST_STEPS


def as_driven(path: Path) -> Chosen:
    """The block that a recording holds."""
    with open_recording(path) as opened:
        reason = str(opened.attrs["extra"].get("chosen_because", "recorded before"))
        return Chosen(str(opened.attrs.get("profile_text", "")), opened.n_samples / opened.rate_hz, reason)


# -- what may be driven ------------------------------------------------------------------------------------------------
def offers(text: str, aims: Aims) -> list[Option]:
    """Every forcing that may be driven, up and down, with the gammas that the limits allow (`InputError`: none)."""
    profile = parse_profile(text, "profile")
    own, found = profile.ramp.gammas(), []
    for ratio in aims.ratios:
        takeoff, own_takeoff = (0.5 if c == 1 else 1.0 / (1.0 + c**2) for c in (ratio, profile.forcing.ratio))
        scale = takeoff / own_takeoff
        # from just above take-off to half as far again as the profile's own ramp
        low, high = max(min(own) * scale, 1.1 * takeoff), 1.5 * max(own) * scale
        range_of_ratio = [float(f"{g:.4g}") for g in np.linspace(low, high, 10)]
        for frequency_hz in aims.frequencies_hz or (profile.forcing.frequency_hz,):
            allowed = [g for g in range_of_ratio if _allowed(text, aims, ratio, frequency_hz, g)]
            if len(allowed) < aims.steps:
                continue
            for gammas in (allowed, allowed[::-1]):
                whole = parse_profile(block_text(text, aims, ratio, frequency_hz, gammas))
                found.append(Option(whole.setup(), tuple(gammas), aims.hold_cycles, partial(_part_seconds, whole)))
    if not found:
        raise InputError(
            f"the limits of this profile allow no block of {aims.steps} steps: raise [limits], or give fewer"
        )
    return found


def block_text(text: str, aims: Aims, ratio: int, frequency_hz: float, gammas: Sequence[float]) -> str:
    """The profile ``text`` with the ramp of a block, its gammas in the order given."""
    return with_values(text, {
        "forcing.ratio": ratio,
        "forcing.frequency_hz": frequency_hz,
        **_in_order(gammas),
        "ramp.hold_cycles": aims.hold_cycles,
        "ramp.settle_cycles": aims.settle_cycles,
    }, "the profile")  # fmt: skip


def _in_order(gammas: Sequence[float]) -> dict[str, Any]:
    """The steps of a ramp, up or down as they are given."""
    return {"ramp.gamma": list(gammas), "ramp.order": "down" if gammas[-1] < gammas[0] else "up"}


def _allowed(text: str, aims: Aims, ratio: int, frequency_hz: float, gamma: float) -> bool:
    """Whether the rig's limits allow a step."""
    try:
        return not planned(parse_profile(block_text(text, aims, ratio, frequency_hz, [gamma])))[2]
    except InputError:
        return False


def _part_seconds(whole: Profile, places: Sequence[int]) -> float:
    """Rig time of a block with only some steps of ``whole``, its fades and the end at rest included."""
    gammas = whole.ramp.gammas()
    ramp = whole.ramp.model_copy(update={"gamma": tuple(gammas[i] for i in places), "order": None})
    return run_seconds(whole.model_copy(update={"ramp": ramp}))


def run_seconds(profile: Profile) -> float:
    """Rig time of a profile's ramp, from the first sample to rest."""
    programme = plan(profile)
    rest = stop_fade_samples(programme.clock) + programme.clock.cycle_start(1)
    return (programme.n_samples + rest) / programme.rate_hz


IN_WORDS = ("name", "description", "calibration_days")  # of a setup: they change no measurement


def staked_block(
    text: str, fitted: FittedLoop, options: Sequence[Option], aims: Aims, recordings: Sequence[Path]
) -> Chosen | None:
    """The block that a verdict on ``recordings`` is staked on, its profile with the prediction; None: none can be."""
    written = f"{software_version()} {software_commit()}".strip(), now_utc()
    found = staked(fitted, options, aims.steps, written, recordings)
    if found is None:
        return None
    block, stake = found
    forcing, own = block.option.setup.forcing, with_values(text, {"stake": None}, "the profile")
    own = block_text(own, aims, forcing.ratio, forcing.frequency_hz, block.gammas).rstrip("\n")
    own = f"{own}\n\n{stake_toml(stake)}"
    named, rival = (" + ".join(names) or "the declared model" for names in (stake.named, stake.rival))
    return chosen(own, f"{named} is staked on it, {stake.nats:.2g} nats against it if {rival} is right")


def write_stake(
    loop: ClosedLoop, fitted: FittedLoop, recordings: Sequence[Path], text: str | None, path: Path
) -> list[str]:
    """Write what the verdict on ``recordings`` is staked on to the file ``path``; what was written, in lines.

    ``text`` is that of the profile by which the loop was closed, if not the first's own (raises `InputError`).
    """
    if loop.verdict != "explained":
        return [f"stake: {path} is not written, because only a verdict that explains everything stakes a prediction"]
    aims = Aims(0.0)
    text = as_driven(recordings[0]).text if text is None else text
    block = staked_block(text, fitted, offers(text, aims), aims, recordings)
    if block is None:
        return [
            f"stake: {path} is not written, because no ramp that the rig may drive would put the verdict to the test"
        ]
    write_whole(path, block.text)
    return [f"stake: {path} ({block.reason})", f"  bench ramp {path} --out next.h5; bench stake {path} next.h5"]


def stake_toml(stake: Stake) -> str:
    """The table ``[stake]``, a line for each step and each parameter."""
    lines = ["[stake]  # predicted before the run; a changed number is another prediction"]
    for name, value in stake.model_dump(mode="json", exclude_none=True).items():
        if isinstance(value, list) and value and isinstance(value[0], dict | list):
            lines += [f"{name} = [", *(f"  {toml_value(row)}," for row in value), "]"]
        else:
            lines.append(f"{name} = {toml_value(value)}")
    return "\n".join(lines) + "\n"


def read_stake(path: Path) -> tuple[Stake, str]:
    """The stake in a file, and the file's text; raises `InputError` where there is none, or it does not fit."""
    text = read_toml_text(path)
    parse_profile(text, str(path))
    stake = stake_in(text, str(path))
    if stake is None:
        raise InputError(f"{path}: [stake]: missing; wanted a file that bench close-loop --stake has written")
    return stake, text


def outcome_of(
    stake: Stake, text: str, recording: Path, known: MutableMapping[Path, Observations] | None = None
) -> Outcome:
    """What a recording says to a stake (`InputError`: it was begun before, is another rig's, or lacks a step)."""
    with open_recording(recording) as opened:
        started = str(opened.attrs.get("started") or "")
        try:
            began, written = (datetime.datetime.fromisoformat(x) for x in (started, stake.written))
            earlier = began < written
        except (ValueError, TypeError):  # imported without a date, or without its zone
            earlier = str(recording) in stake.recordings
        if earlier:
            raise InputError(
                f"{recording}: was begun {started or 'before'}, the prediction was written {stake.written}; only a "
                "later run can meet it: drive the stake with bench ramp"
            )
        staked, own = parse_profile(text, "the stake").setup(), opened.setup
        for name in (f for f in Setup.model_fields if f not in IN_WORDS):
            for key, wanted, found in _differing(getattr(staked, name), getattr(own, name), name):
                raise InputError(
                    f"{recording}: its profile has {key} = {found}, the stake {wanted}; a prediction holds for one "
                    "ball, plate and rig: drive the stake itself with bench ramp, or import with it as --profile"
                )
    numbers = steps_of(stake, recording)
    return held_against(stake, observations_from([recording], known=known), numbers)


def amended(stake: Stake, outcome: Outcome, recording: Path) -> Path | None:
    """The saved verdict that the stake is of, after what came of it was written there; None where there is none."""
    path = verdict_file([Path(name) for name in stake.recordings])
    if not (path.exists() and is_verdict(path)):
        return None
    loop = load_verdict(path)
    if loop.selection.names != stake.named:  # another verdict since
        return None
    save_verdict(with_outcome(loop, outcome, recording.name), path)
    return path


def _differing(a: Any, b: Any, key: str) -> Iterator[tuple[str, Any, Any]]:
    """Dotted keys below which two values differ, with both."""
    a, b = (x.model_dump(mode="json") if hasattr(x, "model_dump") else x for x in (a, b))
    if isinstance(a, dict) and isinstance(b, dict):
        for name in sorted({*a, *b} - {"date", "source"}):
            yield from _differing(a.get(name), b.get(name), f"{key}.{name}")
    elif a != b:
        yield key, a, b
