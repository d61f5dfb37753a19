"""The registry of channels."""

import json

import pytest
from pydantic import ValidationError

from daq.channels.accelerometer import AccelerometerChannel
from daq.channels.registry import CHANNELS, KINDS, Channels
from daq.importers.formats.columns import split_name

SENSOR = AccelerometerChannel(sensitivity=100.0, unit="mV/g", offset_v=0.5)


def test_three_channels_are_in_every_profile_and_further_ones_where_it_says_so() -> None:
    """A frame has the channels of the profile, in the order of the registry."""
    assert CHANNELS == ("continuity", "accelerometer", "drive")
    assert tuple(Channels(accelerometer=SENSOR).recorded()) == CHANNELS
    full = Channels(accelerometer=SENSOR, displacement={"v_per_m": 50.0})
    assert tuple(full.recorded()) == tuple(KINDS)
    assert tuple(Channels(accelerometer=SENSOR, continuity=None).recorded()) == CHANNELS[1:]


def test_a_further_channel_that_is_absent_leaves_no_trace_in_the_text() -> None:
    """What is stored of a profile has the keys of a file from before the kind; an absent contact is still said."""
    text = Channels(accelerometer=SENSOR, continuity=None).model_dump_json()
    assert set(json.loads(text)) == set(CHANNELS) and json.loads(text)["continuity"] is None
    full = Channels(accelerometer=SENSOR, displacement={"v_per_m": 50.0})
    assert Channels.model_validate_json(full.model_dump_json()) == full


def test_scales_to_si() -> None:
    """Each kind turns its own volts into SI; a contact without levels and the drive, which has tones, do not."""
    channels = Channels(accelerometer=SENSOR, displacement={"v_per_m": 50.0, "offset_v": 1.0})
    scales = {name: channel.scale() for name, channel in channels.recorded().items()}
    assert scales["continuity"] == (0.2, 0.0, "0 closed, 1 open") and scales["drive"] is None
    per_volt, zero_v, _ = scales["accelerometer"] or (0.0, 0.0, "")
    assert abs((0.6 - zero_v) * per_volt - 9.80665) < 1e-12
    per_volt, zero_v, unit = scales["displacement"] or (0.0, 0.0, "")
    assert abs((1.5 - zero_v) * per_volt - 10.0) < 1e-12 and unit == "mm"
    assert Channels(accelerometer=SENSOR, continuity={"coupling": "ac"}).recorded()["continuity"].scale() is None


def test_no_name_of_a_column_could_be_two_channels() -> None:
    """Aliases are written as names of columns are compared, and none stands at two kinds."""
    aliases = [alias for kind in KINDS.values() for alias in kind.aliases]
    assert len(set(aliases)) == len(aliases)
    assert all(split_name(alias)[0] == alias for alias in aliases)
    assert all(name in kind.aliases for name, kind in KINDS.items())


def test_the_scale_of_a_displacement_sensor_is_required() -> None:
    """A sensor whose scale the profile does not give is refused: none is assumed."""
    with pytest.raises(ValidationError, match="v_per_m"):
        Channels(accelerometer=SENSOR, displacement={})
