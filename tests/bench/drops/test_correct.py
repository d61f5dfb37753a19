"""Corrections by hand on the page, and what is kept of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from analysis.drop.corrections import NOTHING
from analysis.drop.load import Known
from bench.drops.desk import moved, saved_request, side_file
from bench.drops.worker import refusal_of
from bench.jobs.drop_test import Request
from daq.setup.errors import InputError


def test_a_move_is_one_taken_away_and_one_added() -> None:
    """Moving leaves the found impact out and adds one; moving that again moves the added one only."""
    once = moved(NOTHING, 1.25, 1.26)
    assert (once.ignore_s, once.add_s) == ((1.25,), (1.26,))
    twice = moved(once, 1.26, 1.27)
    assert (twice.ignore_s, twice.add_s) == ((1.25,), (1.27,))
    gone = moved(twice, 1.27, None)
    assert (gone.ignore_s, gone.add_s) == ((1.25,), ())


def test_what_was_taken_away_comes_back_as_found() -> None:
    """An impact added where one was taken away is that one: nothing is left to correct."""
    assert moved(moved(NOTHING, 1.25, None), None, 1.25) == NOTHING


def test_an_impact_of_a_film_is_met_within_frames() -> None:
    """The impact that a fit gives lies a little beside the one added by hand; it is the one that is meant."""
    added = moved(NOTHING, None, 0.5)
    assert moved(added, 0.503, None, same_s=0.01) == NOTHING
    assert moved(added, 0.503, None).ignore_s == (0.503,)


def test_corrections_come_back_from_the_json(tmp_path: Path) -> None:
    """Options and corrections of a kept result are those of the request; of other files it says nothing."""
    file = tmp_path / "tap.wav"
    marks = (moved(NOTHING, 1.25, 1.26),)
    request = Request((file,), fps=240.0, heights_m=(0.3,), corrections=marks, balls=tmp_path / "balls.txt")
    side_file(file).write_text(json.dumps({"options": request.as_json()}), encoding="utf-8")
    assert saved_request(side_file(file), [file]) == request
    assert saved_request(side_file(file), [tmp_path / "other.wav"]) is None
    assert saved_request(tmp_path / "none.json", [file]) is None


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"options": {"files": 3}}', "[" * 100_000])
def test_a_file_of_something_else_is_not_replaced(tmp_path: Path, text: str) -> None:
    """A file of that name that holds no result is refused, so that nothing writes over it."""
    target = tmp_path / "tap.wav.drop.json"
    target.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="result of a drop test"):
        saved_request(target, [tmp_path / "tap.wav"])


def test_a_damaged_sound_is_refused_on_the_page_too(tmp_path: Path) -> None:
    """A WAV file without samples is shown with the reason and no sound; a silent one can be seen to be so."""
    damaged = tmp_path / "bad.wav"
    damaged.write_bytes(b"RIFF\x10\x00\x00\x00WAVEjunkjunkjunk")
    wavfile.write(tmp_path / "quiet.wav", 8000, np.zeros(16000, dtype=np.int16))
    shown = refusal_of(Request((damaged, tmp_path / "quiet.wav")), "damaged", Known())
    assert shown["why"] == "damaged" and [file["kind"] for file in shown["files"]] == ["times", "sound"]
    assert [file["events"] for file in shown["files"]] == [[], []] and shown["files"][1]["duration_s"] == 2.0
