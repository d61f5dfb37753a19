"""Stakes of a verdict: written as a profile that can be driven, and read again with the run that it was staked on."""

from __future__ import annotations

import datetime
from collections.abc import Iterator, MutableMapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.jobs.blocks import Aims, Chosen, as_driven, block_text, forcing_in_words, offers, run_seconds
from bench.jobs.loops.keep_verdict import verdict_file
from bench.profiles.edit import toml_value, with_values
from daq.files.whole_file import write_whole
from daq.recording import open_recording
from daq.setup.clock import now_utc
from daq.setup.errors import InputError
from daq.setup.provenance import software_commit, software_version
from daq.setup.setup import Setup
from daq.setup.stake import Stake, stake_in
from rig.profile import parse_profile

if TYPE_CHECKING:
    from analysis.explore.choice import Option
    from analysis.explore.stake import Outcome
    from analysis.loop.close_loop import FittedLoop
    from analysis.loop.result import ClosedLoop
    from analysis.residuals.observations import Observations

IN_WORDS = ("name", "description", "calibration_days")  # of a setup: they change no measurement


def staked_block(
    text: str, fitted: FittedLoop, options: Sequence[Option], aims: Aims, recordings: Sequence[Path]
) -> Chosen | None:
    """The block that a verdict is staked on, its profile with the prediction; None where none can be.

    Parameters
    ----------
    text
        The profile of the rig.
    fitted, recordings
        The fits behind the verdict, and what it is on.
    options, aims
        Forcings that may be driven, and how long each step is held.
    """
    from analysis.explore.stake import staked

    written = f"{software_version()} {software_commit()}".strip(), now_utc()
    found = staked(fitted, options, aims.steps, written, recordings)
    if found is None:
        return None
    block, stake = found
    forcing = block.option.setup.forcing
    own = with_values(text, {"stake": None}, "the profile")
    own = block_text(own, aims, forcing.ratio, forcing.frequency_hz, block.gammas)
    own = own.rstrip("\n") + "\n\n" + stake_toml(stake)
    profile = parse_profile(own, "the stake")
    named, rival = (" + ".join(names) or "the declared model" for names in (stake.named, stake.rival))
    why = f"{named} is staked on it, {stake.nats:.2g} nats against it if {rival} is right"
    return Chosen(own, run_seconds(profile), f"{forcing_in_words(profile)}: {why}")


def write_stake(
    loop: ClosedLoop, fitted: FittedLoop, recordings: Sequence[Path], text: str | None, path: Path
) -> list[str]:
    """Write what the verdict on ``recordings`` is staked on to the file ``path``; what was written, in lines.

    ``text`` is that of the profile by which the loop was closed, if not the first recording's own.

    Raises `InputError` where that profile cannot be driven.
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
    from daq.setup.strict_toml import read_toml_text

    text = read_toml_text(path)
    parse_profile(text, str(path))
    stake = stake_in(text, str(path))
    if stake is None:
        raise InputError(f"{path}: [stake]: missing; wanted a file that bench close-loop --stake has written")
    return stake, text


def outcome_of(
    stake: Stake, text: str, recording: Path, known: MutableMapping[Path, Observations] | None = None
) -> Outcome:
    """What a later recording says to the stake in the profile ``text``.

    ``known`` is that of `analysis.residuals.observations.observations_from`.

    Raises
    ------
    InputError
        Where it was begun before the prediction was written, is of another rig, or lacks a staked step.
    """
    from analysis.explore.stake import held_against, steps_of
    from analysis.residuals.observations import observations_from

    with open_recording(recording) as opened:
        _refuse_earlier(stake, str(opened.attrs.get("started") or ""), recording)
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
    from analysis.explore.stake import with_outcome
    from analysis.loop.storage import is_verdict, load_verdict, save_verdict

    path = verdict_file([Path(name) for name in stake.recordings])
    if not (path.exists() and is_verdict(path)):
        return None
    loop = load_verdict(path)
    if loop.selection.names != stake.named:  # another verdict since
        return None
    save_verdict(with_outcome(loop, outcome, recording.name), path)
    return path


def _refuse_earlier(stake: Stake, started: str, recording: Path) -> None:
    """Refuse a recording that was there when the prediction was written."""
    try:
        began, written = (datetime.datetime.fromisoformat(x) for x in (started, stake.written))
        earlier = began < written
    except (ValueError, TypeError):  # imported without a date, or without its zone
        earlier = str(recording) in stake.recordings
    if earlier:
        raise InputError(
            f"{recording}: was begun {started or 'before'}, the prediction was written {stake.written}; only a later "
            "run can meet it: drive the stake with bench ramp"
        )


def _differing(a: Any, b: Any, key: str) -> Iterator[tuple[str, Any, Any]]:
    """Dotted keys below which two values differ, with both."""
    a, b = (x.model_dump(mode="json") if hasattr(x, "model_dump") else x for x in (a, b))
    if isinstance(a, dict) and isinstance(b, dict):
        for name in sorted({*a, *b} - {"date", "source"}):
            yield from _differing(a.get(name), b.get(name), f"{key}.{name}")
    elif a != b:
        yield key, a, b
