"""Contradictions between what was measured of the instruments and what the profile says of them.

Decisions 275 and 276.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from daq.channels.continuity import ContinuityChannel
from daq.instrument.measure import DELAYS_S, RESTS, Hold, Measured, volts_per_g
from daq.lock_in import ToneFit
from daq.setup.setup import Setup
from kernels.arrays import Floats

OTHER_SCALE = 1.5  # ratio of gamma at the plate to gamma commanded, up or down, that is a doubt
TAKEOFF_G = (0.2, 3.0)  # accelerations of the plate at take-offs between which the scale is believed
BIAS_G = 0.5  # of the accelerometer's zero

DOUBT_KINDS = (
    "accelerometer_sense", "contact_sense", "drive_sense", "drive_phase", "exchanged", "tones", "bias", "scale", "dead",
    "contact", "resampled", "cut_off", "sweep",
)  # fmt: skip


@dataclass(frozen=True)
class Doubt:
    """A contradiction between a recording and its profile."""

    kind: str  # one of `DOUBT_KINDS`
    finding: str  # the contradiction, with its numbers
    cure: str  # what to write or to do
    makes_meaningless: bool  # whether a verdict on the model would be one on this contradiction

    @property
    def sentence(self) -> str:
        """Finding and cure."""
        return f"{self.finding}; {self.cure}"


def doubts_of(seen: Measured, setup: Setup) -> tuple[Doubt, ...]:
    """Contradictions between recording and profile; a channel that is another's silences what follows from it."""
    for grave in (_exchanged, _dead):
        if found := tuple(grave(seen, setup)):
            return found
    found = (*_tones(seen, setup), *_senses(seen, setup))
    kinds = {doubt.kind for doubt in found}
    scale = () if "tones" in kinds else tuple(_scale(seen, setup))
    if not scale and "contact_sense" not in kinds:
        found += tuple(_contact(seen, setup))
    if "accelerometer_sense" not in kinds:
        scale += tuple(_bias(seen, setup))
    found += scale
    return (*found, *_cut_off(seen, setup), *_interrupted(seen), *_changed(seen))


def _exchanged(seen: Measured, setup: Setup) -> Iterator[Doubt]:
    """A motion where the contact should be, and a contact where a motion should be."""
    if not seen.holds or "continuity" not in seen.holds[0].middle:
        return
    middle = {role: float(np.median([hold.middle[role] for hold in seen.holds])) for role in seen.holds[0].middle}
    # few samples lie between the extremes of a contact, many of a motion
    others = [role for role, part in middle.items() if role != "continuity" and part < 0.06]
    if middle["continuity"] > 0.15 and len(others) == 1:
        yield Doubt(
            "exchanged",
            f"the {others[0]} stands at two levels as a contact does, and the continuity at none",
            f"exchange the columns of continuity and {others[0]} (--map) and import again",
            True,
        )


def _is_silent(hold: Hold) -> bool:
    """Whether the plate is driven, and the accelerometer shows nothing of it."""
    return hold.drive is not None and hold.drive.shows and not hold.plate.shows


def _dead(seen: Measured, setup: Setup) -> Iterator[Doubt]:
    """An accelerometer that shows nothing of the drive."""
    silent = sum(map(_is_silent, seen.holds))
    if silent and 2 * silent >= sum(hold.drive is not None for hold in seen.holds):
        yield Doubt(
            "dead",
            "the accelerometer shows nothing of the drive's motion: it is dead, unplugged, or another column",
            "name its column (--map accelerometer=COLUMN), or record again",
            True,
        )


def _interrupted(seen: Measured) -> Iterator[Doubt]:
    """An accelerometer that shows nothing of the drive for a while."""
    if silent := sum(map(_is_silent, seen.holds)):
        yield Doubt(
            "dead",
            f"the accelerometer shows nothing of the drive in {silent} of the {len(seen.holds)} steps looked at",
            "look for a loose plug; import the file without the rows of these steps",
            False,
        )


def _tones(seen: Measured, setup: Setup) -> Iterator[Doubt]:
    """Tones of the forcing other than the profile's."""
    forcing = setup.forcing
    if not seen.holds:
        yield Doubt(
            "tones",
            f"nothing holds still near the profile's forcing, {forcing.frequency_hz:g} Hz with ratio = {forcing.ratio}",
            "correct frequency_hz and ratio in [forcing], or the columns (--map), and import again",
            True,
        )
        return
    ratios, often = Counter(tuple(round(f / h.tones_hz[0], 2) for f in h.tones_hz) for h in seen.holds).most_common(1)[
        0
    ]
    wanted = sorted(m for m, z in forcing.displacement_tones() if abs(z) > 1e-12)
    # beyond a ratio of 4 the first tone is too weak next to the second to be found
    if often < 0.7 * len(seen.holds) or ratios == tuple(m / wanted[0] for m in wanted) or wanted[-1] > 4:
        return
    first_hz = float(np.median([h.tones_hz[0] for h in seen.holds if len(h.tones_hz) == len(ratios)]))
    names = " and ".join(f"{first_hz * x:.5g} Hz" for x in ratios)
    said = "one tone" if len(ratios) == 1 else f"{len(ratios)} tones"
    if len(ratios) <= 2 and ratios[-1] == round(ratios[-1]):
        cure = f"write frequency_hz = {first_hz:.5g}, ratio = {round(ratios[-1])} in [forcing] and import again"
    else:
        cure = "the model knows one tone, or two of which one is a whole multiple of the other"
    finding = f"the plate is driven with {said} at {names}, where the profile's forcing has ratio = {forcing.ratio}"
    yield Doubt("tones", finding, cure, True)


def _pooled(seen: Measured, which: str) -> Floats:
    """Accelerations at all rises or falls of the contact, (n, delays)."""
    return np.concatenate([np.zeros((0, len(DELAYS_S))), *(getattr(hold, which) for hold in seen.holds)])


def edges_g(seen: Measured, contact: ContinuityChannel | None) -> tuple[Floats, Floats]:
    """The plate's acceleration at openings and closings of the contact, by the profile, in g, (n, delays)."""
    rises, falls = _pooled(seen, "rises_g"), _pooled(seen, "falls_g")
    return (rises, falls) if contact is None or contact.swing_v > 0.0 else (falls, rises)


def at_edges_g(edges: Floats) -> float | None:
    """Median acceleration at edges (n, delays); None where there are few."""
    return float(np.median(edges[:, len(DELAYS_S) // 2])) if len(edges) >= 8 else None


def _spread(edges: Floats) -> float:
    """Relative spread of the accelerations at edges (n, delays), for the delay at which it is least."""
    low, middle, high = np.quantile(edges, [0.25, 0.5, 0.75], axis=0)
    return float(np.min((high - low) / np.maximum(np.abs(middle), 1e-9)))


def _senses(seen: Measured, setup: Setup) -> Iterator[Doubt]:
    """Sense of accelerometer, contact and drive.

    A ball at rest leaves where the plate falls at about g: take-offs lie close together at -1 g, landings are spread
    over positive accelerations.
    """
    sensor, contact = setup.channels.accelerometer, setup.channels.continuity
    opens, closes = edges_g(seen, contact)
    at, other, rest_g = at_edges_g(opens), at_edges_g(closes), _rest_g(seen, setup)
    turned = False
    if at is not None and other is not None and contact is not None:
        # take-offs are the edges whose accelerations lie closer together; in a single locked motion landings lie as
        # close together, and take-offs are those nearer to g
        spread, other_spread = _spread(opens), _spread(closes)
        if max(spread, other_spread) > 0.2:
            # take-offs lie near -g whatever the flight was, landings anywhere: the spreads differ by far
            closings_are_takeoffs = other_spread < 0.4 * spread
        else:
            from_g, other_from_g = (abs(math.log(max(abs(x), 1e-9))) for x in (at, other))
            closings_are_takeoffs = other_from_g < from_g and at > 0.0
        if at * other < 0.0 and closings_are_takeoffs:
            at = other
            yield Doubt(
                "contact_sense",
                f"the contact's {len(closes)} closings are the ball's take-offs: flight and contact are exchanged",
                f"write open_v = {contact.closed_v.value:g}, closed_v = {contact.open_v.value:g} in "
                "[channels.continuity]",
                True,
            )
        turned = at > 0.0 and at * other <= at * at
    turned_at_rest = at is None and sensor.reads_gravity and rest_g is not None and abs(rest_g + 1.0) < BIAS_G
    if turned or turned_at_rest:
        shown = (
            f"{at:+.2f} g where the ball leaves it, not at -1 g" if turned else f"{rest_g:+.2f} g at rest, not at +1 g"
        )
        yield Doubt(
            "accelerometer_sense",
            f"the accelerometer is inverted: it shows the plate at {shown}",
            f"write sign = {-sensor.sign:d} in [channels.accelerometer]",
            True,
        )
    phase_deg = drive_phase_deg(seen, setup)
    if phase_deg is not None and abs(phase_deg) > 120.0 and at is not None and not turned:
        yield Doubt(
            "drive_sense",
            f"the plate moves {phase_deg:+.0f} degrees after the drive",
            "turn its leads, or write phase_deg = 180 in [drive]",
            False,
        )
    # 5 ms at 25 Hz: no converter's filter and no amplifier is so late; later still at a higher tone
    elif phase_deg is not None and abs(phase_deg) > 45.0 * setup.forcing.ratio and not turned:
        multiples = [_strongest(hold.drive, hold.frequency_hz)[1] for hold in seen.holds if hold.drive is not None]
        scale = setup.drive.scale(multiples[0])
        yield Doubt(
            "drive_phase",
            f"the plate is {phase_deg:+.0f} degrees after what [drive{'' if scale is setup.drive else '.second'}] says",
            f"write phase_deg = {round(scale.phase_deg.value + phase_deg)} there, or find the late channel",
            True,
        )


def _strongest(drive: ToneFit, first_hz: float) -> tuple[int, int]:
    """Strongest tone of the drive: its index, and its multiple of the forcing."""
    k = int(np.argmax(np.abs(drive.amplitudes)))
    return k, round(float(drive.frequencies_hz[k]) / first_hz)


def drive_phase_deg(seen: Measured, setup: Setup) -> float | None:
    """Phase of the plate after the drive beyond the declared one, at the strongest tone; None without a drive."""
    turns = []
    for hold in seen.holds:
        if hold.drive is not None:
            k, multiple = _strongest(hold.drive, hold.frequency_hz)
            declared = np.exp(-1j * np.radians(setup.drive.scale(multiple).phase_deg.value))
            turns.append(declared * hold.plate.amplitudes[k] / hold.drive.amplitudes[k])
    if not np.any(turns):
        return None
    sense = np.sign(setup.channels.accelerometer.volts_per_mps2)
    return float(np.degrees(np.angle(np.sum(np.exp(1j * np.angle(turns))) * sense)))


def _contact(seen: Measured, setup: Setup) -> Iterator[Doubt]:
    """A contact that never opens though the plate throws the ball, or is open where it rests."""
    contact = setup.channels.continuity
    if contact is None or seen.levels_v is None:
        return
    low, high = seen.levels_v
    declared = f"the profile says open_v = {contact.open_v.value:g}, closed_v = {contact.closed_v.value:g}"
    # a circuit that works changes by its whole swing; hum and crosstalk change it by a few percent
    if high - low < 0.1 * abs(contact.swing_v):
        peaks_g = [hold.peak_g for hold in seen.holds]
        is_open = abs(low + high - 2.0 * contact.open_v.value) < abs(low + high - 2.0 * contact.closed_v.value)
        # beyond 1.5 g downwards the ball certainly leaves the plate
        if max(peaks_g, default=0.0) > 1.5:
            # a ball that is launched wherever it lands closes no circuit; one that rests between flights would
            launched = is_open and min(peaks_g) > 1.5
            yield Doubt(
                "contact",
                f"the contact circuit stays between {low:.3g} and {high:.3g} V while the plate reaches "
                f"{max(peaks_g):.2g} g",
                "landings are those that the accelerometer shows; look for a broken wire if the ball rests on the plate"
                if launched
                else f"no flight can be seen: look for a broken wire, or another column ({declared})",
                not launched,
            )
        return
    resting = [
        hold.high for hold in seen.holds
        if hold.peak_g < RESTS and "continuity" in hold.middle and not _is_silent(hold)
    ]  # fmt: skip
    open_part = np.median(resting) if resting else np.nan
    if contact.swing_v < 0.0:
        open_part = 1.0 - open_part
    if open_part > 0.5:
        yield Doubt(
            "contact_sense",
            f"the contact circuit says flight while the plate moves by less than {RESTS:g} g, where the ball rests",
            f"{declared}: exchange them",
            True,
        )


def _scale(seen: Measured, setup: Setup) -> Iterator[Doubt]:
    """Gamma at the plate far from gamma commanded, or from that of the take-offs."""
    table = np.array([hold.gammas(setup) for hold in seen.holds]).reshape(-1, 3)
    known = np.isfinite(table).all(axis=1) & (table[:, 0] > 0.0)
    at_g = abs(at_edges_g(edges_g(seen, setup.channels.continuity)[0]) or 1.0)
    if not known.any() or setup.drive.g_per_volt is None:
        if not TAKEOFF_G[0] < at_g < TAKEOFF_G[1]:
            yield Doubt(
                "scale",
                f"the ball leaves where the accelerometer shows the plate falling at {at_g:.2g} g instead of 1 g",
                "correct sensitivity or unit in [channels.accelerometer], or the column's unit (--map ...:mV)",
                True,
            )
        return
    commanded, shown = (float(x) for x in np.median(table[known, :2], axis=0))
    ratio = float(np.median(table[known, 1] / table[known, 0]))
    if 1.0 / OTHER_SCALE < ratio < OTHER_SCALE:
        return
    both = f"the drive asks for gamma {commanded:.3g}, the accelerometer shows {shown:.3g} (medians over the steps)"
    exchanged = ratio * (abs(volts_per_g(setup)) * setup.drive.g_per_volt.value) ** 2  # ratio, were they exchanged
    if abs(np.log(max(exchanged, 1e-300))) < np.log(OTHER_SCALE):
        cure = "exchanged they would agree: exchange the columns of accelerometer and drive (--map) and import again"
        yield Doubt("exchanged", both, cure, True)
    elif ratio < 0.05:
        yield Doubt("scale", both, "it is dead or unplugged, or its sensitivity is wrong by far", True)
    elif at_g != 1.0 and abs(np.log(at_g)) < np.log(OTHER_SCALE):
        cure = (
            f"the ball's take-offs bear the accelerometer out: correct g_per_volt in [drive] (about {ratio:.3g} times)"
        )
        yield Doubt("scale", both, cure, False)
    else:
        cure = "correct g_per_volt in [drive], or sensitivity and unit in [channels.accelerometer]"
        yield Doubt("scale", both, cure, True)


def ends_g(seen: Measured, setup: Setup) -> tuple[float | None, float | None]:
    """Lowest and highest acceleration that the accelerometer shows; None for an end that it does not reach."""
    offset_v = setup.channels.accelerometer.offset_v
    zero_v = 0.0 if offset_v is None else offset_v.value
    low, high = sorted((end - zero_v) / volts_per_g(setup) for end in seen.ends_v)
    return low if math.isfinite(low) else None, high if math.isfinite(high) else None


def _cut_off(seen: Measured, setup: Setup) -> Iterator[Doubt]:
    """Motion beyond the accelerometer's end, and a drive beyond its own; impacts beyond it do no harm."""
    if seen.cut_off:
        ends = " and ".join(f"{end:+.3g} g" for end in ends_g(seen, setup) if end is not None)
        yield Doubt(
            "cut_off",
            f"the accelerometer is at its end at {ends}, and the plate goes beyond in {seen.cut_off} of the "
            f"{len(seen.holds)} steps that were looked at",
            "gamma comes from the rest of each cycle there, less exactly: take a sensor or a range that goes farther",
            False,
        )
    if seen.drive_cut_off:
        yield Doubt(
            "cut_off",
            f"the drive's reading is cut off in {seen.drive_cut_off} of the {len(seen.holds)} steps that were looked "
            "at, and says less than what moves the plate",
            "what the accelerometer shows counts there: record the drive with a larger range",
            False,
        )


def _changed(seen: Measured) -> Iterator[Doubt]:
    """An amplitude that is swept, and readings that are not the sensor's own."""
    growths = np.array([hold.growth for hold in seen.holds])
    # of one sign in nearly all holds, upwards or downwards: neither noise nor a slow modulation
    if len(growths) >= 6 and abs(np.median(growths)) > 5e-3 and abs(np.mean(np.sign(growths))) > 0.8:
        finding = f"the amplitude is swept: it changes by {np.median(growths):+.1%} within a hold (median)"
        cure = "drive in steps, each held for some cycles; flights and their diagram are right all the same"
        yield Doubt("sweep", f"{finding}, and the model has it constant", cure, True)
    blurred = "impacts are blurred, and their times with them"
    if seen.interpolation_hz is not None:
        finding = (
            f"the noise of several channels comes and goes at {1e-3 * seen.interpolation_hz:.3g} kHz, as where a file "
            "was brought to another rate by linear interpolation"
        )
        yield Doubt("resampled", finding, f"import the file as it was recorded: {blurred}", False)
    if seen.held_samples > 1.0:
        finding = (
            f"each reading of the accelerometer stands for {seen.held_samples:.3g} samples, as where a sensor is "
            "slower than the recording, or a table was filled with the value before"
        )
        yield Doubt("resampled", finding, f"lines are drawn between the readings: {blurred}", False)


def _rest_g(seen: Measured, setup: Setup) -> float | None:
    """The accelerometer's reading at rest by the profile, in units of g; None where that is not known."""
    sensor = setup.channels.accelerometer
    if seen.bias_v is None or sensor.coupling == "ac" or sensor.offset_v is None:
        return None
    return (seen.bias_v - sensor.offset_v.value) / volts_per_g(setup)


def _bias(seen: Measured, setup: Setup) -> Iterator[Doubt]:
    """A zero of the accelerometer other than the declared one."""
    sensor, rest_g = setup.channels.accelerometer, _rest_g(seen, setup)
    if rest_g is None or sensor.offset_v is None or seen.bias_v is None:
        return
    off_g = rest_g - float(sensor.reads_gravity)
    sigma_g = sensor.offset_v.uncertainty / abs(volts_per_g(setup))
    if abs(off_g) < max(BIAS_G, 5.0 * sigma_g):
        return
    zero_v = seen.bias_v - float(sensor.reads_gravity) * volts_per_g(setup)
    cure = f"write offset_v = {zero_v:.4g} in [channels.accelerometer], or leave it out (unknown)"
    if abs(abs(off_g) - 1.0) < 0.1:
        cure = f"write reads_gravity = {str(not sensor.reads_gravity).lower()}, or offset_v = {zero_v:.4g}"
    yield Doubt(
        "bias",
        f"the accelerometer rests at {seen.bias_v:.4g} V, {off_g:+.3g} g from where the profile's offset_v = "
        f"{sensor.offset_v.value:g} puts it",
        cure,
        True,
    )
