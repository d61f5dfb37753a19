"""Profiles: what is taken, what is refused, and how it is said."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from bench.profiles.find import find_profile, load, load_measuring, shipped_folder, shipped_names
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from rig.profile import json_schema, load_profile, load_setup, parse_profile

SHIPPED = ("c2", "c3", "paper", "simulated", "slow_sweep", "soundcard")
GOOD = (shipped_folder() / "simulated.toml").read_text(encoding="utf-8")


def refusal(text: str) -> str:
    """The message with which ``text`` is refused."""
    with pytest.raises(InputError) as caught:
        parse_profile(text, "rig.toml")
    return str(caught.value)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_profiles_are_whole(name: str) -> None:
    """Every shipped profile loads, and its measuring part survives the trip through a recording's JSON."""
    profile, text = load_profile(find_profile(name))
    assert profile.name == name and text.startswith("#:schema")
    assert Setup.model_validate_json(profile.setup().model_dump_json()) == profile.setup()


def test_paper_is_the_seed_experiment() -> None:
    """The paper's figures: 249.2 g, 20 kHz, 20 Hz, one sine."""
    profile, _ = load_profile(find_profile("paper"))
    assert (profile.ball.mass_kg, profile.sampling.rate_hz) == (0.2492, 20000)
    assert (profile.forcing.frequency_hz, profile.forcing.ratio) == (20.0, 1)


def test_shipped_names_are_those_listed() -> None:
    """The list of shipped profiles is what the folder holds."""
    assert tuple(shipped_names()) == SHIPPED


def test_schema_file_is_up_to_date() -> None:
    """The schema that editors read is the one the code generates, and it lets a quantity be a bare number."""
    text = (shipped_folder() / "profile.schema.json").read_text(encoding="utf-8")
    assert text == json_schema()
    sensitivity = json.loads(text)["$defs"]["AccelerometerChannel"]["properties"]["sensitivity"]
    assert "QuantityTable" in json.dumps(sensitivity)
    assert {"type": "number"} in json.loads(text)["$defs"]["QuantityTable"]["anyOf"]


def test_every_fault_is_named_at_once() -> None:
    """Many faults come back in one message, each with its dotted key, what was wanted and what came."""
    bad = (
        GOOD.replace("rate_hz = 20000", "rate = 20000")
        .replace("frequency_hz = 25.37", 'frequency_hz = "25 Hz"')
        .replace('unit = "V/g"', 'unit = "V/m"')
        .replace("mass_kg = 0.2492", "mass_kg = -1")
        .replace("settle_cycles = 10", "settle_cycle = 10")
        .replace("drive_v = 9.5\n", "")
    )
    message = refusal(bad)
    for line in (
        "rig.toml: 6 faults",
        "sampling.rate: unknown key; did you mean rate_hz?, came 20000",
        'forcing.frequency_hz: wanted a number, came "25 Hz"',
        "channels.accelerometer.unit: wanted 'V/g', 'mV/g', 'V/(m/s^2)' or 'mV/(m/s^2)', came \"V/m\"",
        "ball.mass_kg: wanted a number greater than 0, came -1",
        "ramp.settle_cycle: unknown key; did you mean settle_cycles?, came 10",
        "limits.drive_v: missing; this key is required",
    ):
        assert line in message


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("ratio = 1 ", "ratio = 1.5 ", "forcing.ratio: wanted a whole number, came 1.5"),
        ("ratio = 1 ", "ratio = 0 ", "forcing.ratio: wanted a number at least 1, came 0"),
        ("amplitude = [1.0, 1.0]", "amplitude = [1.0, nan]", "forcing.amplitude[1]: wanted a finite number"),
        ("phase_deg = [0.0, 0.0]", "phase_deg = [0.0, 180.0]", "forcing: the two tones cancel"),
        ("amplitude = [1.0, 1.0]", "amplitude = [1e308, 1e308]", "forcing: amplitude is relative to A"),
        ("closed_v = { value = 0.0", "closed_v = { value = 5.0", "continuity: open_v and closed_v are both 5 V"),
        ("open_v = { value = 5.0", "open_v = { value = 12.0", "open_v or closed_v lies outside range_v = 10 V"),
        ("sensitivity = { value = 0.1,", "sensitivity = { value = -0.1,", "channels.accelerometer.sensitivity"),
        ("date = 2026-11-20", 'date = "soon"', "drive.g_per_volt.date"),
        ('order = "up"', 'order = "upwards"', "ramp.order: wanted 'up', 'down', 'up-and-down' or 'shuffled'"),
        ("{ start = 0.4, stop = 2.6, steps = 23 }", "[0.5, -0.7]", "ramp.gamma[1]: wanted a number at least 0"),
        ("{ start = 0.4, stop = 2.6, steps = 23 }", "[]", "ramp.gamma: wanted 1 to 100000 gammas, came 0"),
        ("steps = 23", "steps = 1", "ramp.gamma: one step cannot go from 0.4 to 2.6"),
        ("drive_v = 9.5", "drive_v = true", "limits.drive_v: wanted a number, came true"),
        ('kind = "simulated"', 'kind = "labjack"', "backend.kind: wanted 'simulated', "),
        ('kind = "simulated"', 'kind = "soundcard"', "backend: device: missing; a soundcard is chosen by name"),
        ('kind = "simulated"', "buffer_s = 0.1", "backend.buffer_s: is for backend.kind = 'nidaqmx'"),
        ('kind = "simulated"', "block_sample = 64", "backend.block_sample: unknown key; did you mean block_samples?"),
        ('kind = "simulated"', "block_samples = 1", "backend.block_samples: wanted a number at least 16"),
        ('[backend]\nkind = "simulated"', "[backend.x]", "backend.x: unknown key"),
        ("frequency_hz = 25.37", "frequency_hz = 3000.0", "wanted at least 8 samples in a cycle of the fastest tone"),
        ("rate_hz = 20000", "rate_hz = ", "not valid TOML"),
    ],
)
def test_each_class_of_fault(old: str, new: str, said: str) -> None:
    """One fault at a time is refused with words that name it."""
    assert old in GOOD
    assert said in refusal(GOOD.replace(old, new))


def test_missing_drive_scale_is_refused_for_driving_only(tmp_path: Path) -> None:
    """A rig without a drive scale cannot be driven, but its recordings can be read."""
    text = "\n".join(line for line in GOOD.splitlines() if not line.startswith("g_per_volt"))
    assert "drive.g_per_volt: missing" in refusal(text)
    path = tmp_path / "rig.toml"
    path.write_text(text, encoding="utf-8")
    assert load_setup(path)[0].drive.g_per_volt is None


def test_foreign_recording_needs_no_ramp(tmp_path: Path) -> None:
    """The measuring part loads alone; a ramp that is there is still checked."""
    measuring = GOOD[: GOOD.index("[ramp]")]
    path = tmp_path / "foreign.toml"
    path.write_text(measuring, encoding="utf-8")
    setup, text = load_measuring(path)
    assert setup.ball.mass_kg == 0.2492 and text == measuring
    with pytest.raises(InputError, match=r"ramp: missing"):
        load_profile(path)
    path.write_text(measuring + "[ramp]\ngamma = 3\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"ramp\.gamma: wanted a table"):
        load_setup(path)


def test_orders() -> None:
    """Up, down, up-and-down and shuffled run the same gammas in their order; a bare list runs as written."""

    def gammas(ramp: str) -> tuple[float, ...]:
        head, rest = GOOD.split("[ramp]")
        return parse_profile(head + "[ramp]\n" + ramp + "\n[limits]" + rest.split("[limits]")[1]).ramp.gammas()

    assert gammas("gamma = [0.3, 0.1, 0.2]") == (0.3, 0.1, 0.2)
    assert gammas('gamma = [0.3, 0.1, 0.2]\norder = "up"') == (0.1, 0.2, 0.3)
    assert gammas('gamma = [0.3, 0.1, 0.2]\norder = "down"') == (0.3, 0.2, 0.1)
    assert gammas('gamma = [0.3, 0.1, 0.2]\norder = "up-and-down"') == (0.1, 0.2, 0.3, 0.2, 0.1)
    table = "gamma = { start = 0.1, stop = 1.0, steps = 10 }\n"
    first, again, other = (gammas(f'{table}order = "shuffled"\nseed = {seed}') for seed in (1, 1, 2))
    assert first == again != other
    assert sorted(first) == list(gammas(table)) == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]


def test_unreadable_file(tmp_path: Path) -> None:
    """A file that is not there, or is not text, is an input error that names it."""
    with pytest.raises(InputError, match=r"nowhere\.toml"):
        load_profile(tmp_path / "nowhere.toml")
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"UTF-8"):
        load_profile(binary)


def test_unknown_name_is_answered_with_a_near_one() -> None:
    """A misspelt shipped profile is answered with the right name."""
    with pytest.raises(InputError, match=r"did you mean simulated\?"):
        find_profile("simulatd")


def test_declared_effects_are_checked_by_name_and_parameter(tmp_path: Path) -> None:
    """A declared effect or parameter that nobody knows is refused with its key; a known one is taken."""
    path = tmp_path / "rig.toml"
    good = "\n[declared.coulomb_friction]\nmu_up = 0.3\nmu_down = 0.3\n"
    path.write_text(GOOD + good, encoding="utf-8")
    assert load(path)[0].declared_values() == {"coulomb_friction": {"mu_up": 0.3, "mu_down": 0.3}}
    bad = "\n[declared.coulomb_frction]\nmu_up = 0.3\n[declared.restitution]\ne = 0.5\n"
    path.write_text(GOOD + bad, encoding="utf-8")
    for reader in (load, load_measuring):
        with pytest.raises(InputError) as caught:
            reader(path)
        message = str(caught.value)
        assert "declared.coulomb_frction" in message and "did you mean coulomb_friction?" in message
        assert "declared.restitution" in message


@pytest.mark.parametrize(
    "text",
    [f"a = {'[' * 1000}{']' * 1000}", f"a = {'{a=' * 1000}1{'}' * 1000}", f"[{'.'.join('a' * 3000)}]\nx = 1"],
)
def test_a_file_nested_a_thousand_deep_is_refused_in_a_line(text: str) -> None:
    """Lists, inline tables and dotted tables too deep in one another are bad input like any other."""
    assert "too deep in one another" in refusal(text)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("ratio = 1 ", "ratio = " + "9" * 5000 + " ", "thousands of digits"),
        ("date = 2026-11-20", 'date = "soon"', 'date: wanted a date as 2026-11-20, came "soon"'),
        ("date = 2026-11-20", "date = 5", "date: wanted a date as 2026-11-20, came 5"),
        ("amplitude = [1.0, 1.0]", "amplitude = [1.0, 1, 2]", "amplitude: wanted at most 2 values, came [1.0, 1, 2]"),
        ("amplitude = [1.0, 1.0]", "amplitude = 'a'", 'amplitude: wanted a list in brackets, came "a"'),
        ("[ramp]", "[declared]\nx = 1\n[ramp]", "declared.x: wanted a table, came 1"),
        ("rate_hz = 20000", "rate_hz = 20e6", "sampling.rate_hz: wanted at most 1e+06 to drive a ramp"),
    ],
)
def test_a_fault_is_said_in_the_words_of_the_file(old: str, new: str, said: str) -> None:
    """No word of the checking library reaches the screen: what was wanted, what came, in the file's terms."""
    message = refusal(GOOD.replace(old, new))
    assert said in message
    assert "Input should" not in message


def test_a_ratio_beyond_any_run_is_refused() -> None:
    """c above a thousand is refused where a ramp is to be driven."""
    text = GOOD.replace("ratio = 1 ", "ratio = 2000 ").replace("frequency_hz = 25.37", "frequency_hz = 0.5")
    assert "forcing.ratio: wanted at most 1000" in refusal(text)


def test_a_marker_beyond_the_drives_limit_is_refused() -> None:
    """The chirp at the start passes no clamp, so its profile is refused: the limit holds for all that is played."""
    text = re.sub(r"drive_v = [0-9.]+", "drive_v = 0.05", GOOD)
    assert text != GOOD and "backend.marker_v: the chirp" in refusal(text)
