"""Checks before a run: a chirp, a quiet tone, a short flight, a tap; and a verdict on each against the profile.

Nothing is driven that the profile's limits forbid, and the drive fades in and out. What cannot be judged is reported
as such; every bad verdict carries a remedy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from daq.clocks.clock_sync import find_marker, start_marker
from daq.files.tables import step_row
from daq.instrument.instrument import examine
from daq.lock_in import fit_tones
from kernels.arrays import Complexes, Floats
from rig.backends.base import Backend, running
from rig.profile import Profile
from rig.programme.ramp import Fade, PhaseClock, drive_amplitudes, forbidden, peaks, plan, synthesise
from rig.programme.sequencer import largest_block

LOWEST_HZ, HIGHEST_HZ = 0.7, 200.0


def mode_of_tap(acceleration: Floats, rate_hz: float) -> tuple[float, float] | None:
    """Frequency in Hz and damping over critical of the mode that rings longest after a tap; None where none is seen.

    ``acceleration`` (n,) is in any unit, from before the tap on.
    """
    # block means at 1 kHz: far above any mode that a ball shakes
    width = max(round(rate_hz / 1000.0), 1)
    x = acceleration[: len(acceleration) // width * width].reshape(-1, width).mean(axis=1)
    block_s = width / rate_hz
    away = np.abs(acceleration - np.median(acceleration))
    # a tap stands out of the noise by twenty times; of an input that stands still nothing does
    if not np.max(away) > 20.0 * 1.4826 * np.median(away):
        return None
    first = int(np.argmax(away)) // width + round(0.02 / block_s)  # the hammer itself is over
    x = x[first : first + round(4.0 / block_s)]
    if len(x) < round(2.0 / LOWEST_HZ / block_s):
        return None
    time_s = np.arange(len(x)) * block_s
    x = x - np.mean(x[len(x) // 2 :])  # the end is the zero: it has rung out
    hz = np.fft.rfftfreq(8 * len(x), block_s)
    inside = (hz > LOWEST_HZ) & (hz < HIGHEST_HZ)
    start_hz = float(hz[inside][np.argmax(np.abs(np.fft.rfft(x, 8 * len(x)))[inside])])

    def left(p: Floats) -> Floats:
        w, damping = 2.0 * math.pi * math.exp(p[0]), math.exp(p[1])
        own = np.exp((-damping + 1j * math.sqrt(1.0 - damping**2)) * w * time_s)
        shape = np.column_stack([own.real, own.imag, np.ones(len(x))])
        return np.asarray(x - shape @ np.linalg.lstsq(shape, x, rcond=None)[0])

    low, high = np.log([[LOWEST_HZ, 1e-4], [HIGHEST_HZ, 0.9]])
    fits = [
        least_squares(left, np.clip(np.log([start_hz, damping]), low, high), bounds=(low, high), x_scale=0.1)
        for damping in (0.01, 0.1)
    ]
    best = min(fits, key=lambda fit: fit.cost)
    # at least half of the power is the mode's
    if 2.0 * best.cost >= 0.5 * float(x @ x):
        return None
    return float(np.exp(best.x[0])), float(np.exp(best.x[1]))


QUIET_PEAK = 0.3  # of g: the ball stays down
FLIGHT_PEAK = 1.6  # of g: the ball takes off
FADE_CYCLES, SETTLE_CYCLES, HOLD_CYCLES = 8, 8, 20
TAP_S = 10.0  # in which the table is hit
SCALE_OFF = 0.05  # by which the accelerometer may be off, at least
MOVES = {"tap": "accelerometer", "lift": "continuity"}  # the input that answers what a hand does


@dataclass(frozen=True)
class Finding:
    """One line of the report; ``passed`` is None where it could not be judged."""

    what: str
    seen: str
    passed: bool | None
    remedy: str = ""


class Check:
    """The findings on one rig.

    Parameters
    ----------
    profile
        Description of the rig.
    backend
        Not yet started.
    ask_tap
        Called when the table is to be hit; without it there is no tap.
    """

    def __init__(self, profile: Profile, backend: Backend, ask_tap: Callable[[], None] | None = None) -> None:
        self._profile, self._backend, self._ask_tap = profile, backend, ask_tap
        self._clock = PhaseClock.of(profile.forcing.frequency_hz, profile.sampling.rate_hz)
        self._block = largest_block(self._clock, profile.backend.block_samples)
        self._per_g = peaks(profile, 1.0).gamma_peak
        self._contact_v = 0.0
        self._instrument: list[Finding] = []

    def run(self) -> list[Finding]:
        """Start the rig, look, and let it go; raises `BackendError` where it does not answer."""
        with running(self._backend):
            rest = self._rest(0.5)
            findings, delay = self._loopback()
            tone, quiet = self._tone(QUIET_PEAK, delay)
            findings += [*self._motion(tone, quiet, delay), *self._contact(rest), *self._instrument]
            findings += self._noise(rest)
            findings += self._margins(quiet)
            if self._ask_tap is not None:
                self._ask_tap()
                findings.append(self._tapped())
        return findings

    def card(self) -> list[Finding]:
        """What each input carries at rest, and the loop-back; raises `BackendError`."""
        with running(self._backend):
            rest = self._rest(0.5)
            return [*self._loopback()[0], *self._noise(rest)]

    def wiring(self) -> list[Finding]:
        """Exchanged inputs and senses, by a quiet tone and a short flight, no scales; raises `BackendError`."""
        with running(self._backend):
            rest = self._rest(0.5)
            findings, delay = self._loopback()
            motion = self._motion(*self._tone(QUIET_PEAK, delay), delay)
            return [*findings, *(f for f in motion if not f.what.endswith("sensitivity")), *self._contact(rest)]

    def moved(self, move: str, now: Callable[[], object], seconds: float = 4.0) -> Finding:
        """Which input answers what a hand does (one of `MOVES`), for so many seconds; nothing is driven.

        ``now`` is called once the rig was heard at rest: the person begins. Raises `BackendError` where the device is
        silent.
        """
        with running(self._backend):
            rest = self._rest(0.5)
            now()
            heard = self._rest(seconds)
        asked, contact = MOVES[move], self._profile.channels.continuity
        moved_v = {name: float(np.max(np.abs(volts - np.median(rest[name])))) for name, volts in heard.items()}
        # 12 standard deviations: noise reaches 5 in some 1e5 samples, or one code of an input that stands still; the
        # ball's circuit has to open
        least_v = {name: max(12.0 * float(np.std(v)), 4.0 * self._backend.scales[name][0]) for name, v in rest.items()}
        if move == "lift" and contact is not None:
            least_v = dict.fromkeys(rest, 0.5 * abs(contact.swing_v))
        seen = ", ".join(f"{name} by {volts:.3g} V" for name, volts in moved_v.items())
        if moved_v.get(asked, 0.0) > least_v.get(asked, 0.0):
            return Finding(f"{move}: {asked}", seen, True)
        other = next((name for name in moved_v if name != "drive" and moved_v[name] > least_v[name]), None)
        if other is None:
            remedy = "nothing answered: is the sensor plugged in? Move it again"
            return Finding(f"{move}: {asked}", seen, False, remedy)
        seen = f"the {other} input reads what the {asked} input should"
        return Finding("inputs", seen, False, "change their plugs, or their numbers (terminals) in the profile")

    def _rest(self, seconds: float) -> dict[str, Floats]:
        """Volts of every channel while nothing is driven."""
        return self._play(np.zeros(round(seconds * self._profile.sampling.rate_hz)))

    def _play(self, drive_v: Floats) -> dict[str, Floats]:
        """Volts of every channel while ``drive_v`` is played."""
        limit = self._profile.limits.drive_v
        blocks = [
            self._backend.exchange(np.clip(drive_v[k : k + self._block], -limit, limit))
            for k in range(0, len(drive_v), self._block)
        ]
        codes = np.concatenate([block.codes for block in blocks])
        scales = self._backend.scales
        return {
            name: np.asarray(codes[:, k] * scales[name][0] + scales[name][1], np.float64)
            for k, name in enumerate(self._backend.channels)
        }

    def _loopback(self) -> tuple[list[Finding], int]:
        """Delay of the looped-back drive, from a chirp."""
        rate_hz = self._profile.sampling.rate_hz
        quiet, marker = np.zeros(round(0.5 * rate_hz)), start_marker(rate_hz)
        marker_v = self._profile.backend.marker_v
        heard = self._play(np.concatenate([quiet, marker_v * marker, quiet]))["drive"]
        found = find_marker(heard, marker)
        if found is None:
            remedy = "loop the amplifier's input back into the drive channel; see that it is not turned round"
            return [Finding("loop-back delay", f"the chirp of {marker_v:g} V is not heard", False, remedy)], 0
        delay = found - len(quiet)
        part = delay / rate_hz * self._profile.forcing.frequency_hz
        seen = f"{delay:.2f} samples, {1e3 * delay / rate_hz:.1f} ms, {part:.2f} of a forcing cycle"
        remedy = "over one cycle the interlock comes too late: a smaller backend.buffer_s, a faster driver"
        return [Finding("output latency and loop-back delay", seen, bool(part <= 1.0), remedy)], round(delay)

    def _tone(self, peak_g: float, delay: int) -> tuple[slice, dict[str, Floats]]:
        """A tone of ``peak_g`` that fades in and out: where it held, as heard, and what was heard."""
        gamma = peak_g / self._per_g
        target = drive_amplitudes(self._profile, gamma)
        zero = tuple(0j for _ in target)
        start, settled, end = (
            self._clock.cycle_start(n)
            for n in (FADE_CYCLES, FADE_CYCLES + SETTLE_CYCLES, FADE_CYCLES + SETTLE_CYCLES + HOLD_CYCLES)
        )
        multiples = tuple(m for m, _ in self._profile.forcing.displacement_tones())
        up = synthesise(self._clock, multiples, Fade(0, start, zero, target), 0, end)
        down = synthesise(self._clock, multiples, Fade(end, start, target, zero), end, start)
        heard = self._play(np.concatenate([up, down, np.zeros(delay + 1)]))
        return slice(settled + delay, end + delay), heard

    def _motion(self, hold: slice, heard: dict[str, Floats], delay: int) -> list[Finding]:
        """Loop-back gain, and the accelerometer's answer to it."""
        profile = self._profile
        tones = [(m, abs(d)) for m, d in profile.forcing.displacement_tones()]
        frequencies_hz = [m * profile.forcing.frequency_hz for m, _ in tones]
        fitted = {
            name: fit_tones(volts[hold], hold.start - delay, profile.sampling.rate_hz, frequencies_hz).amplitudes
            for name, volts in heard.items()
        }
        # the tone with the largest acceleration: m^2 times its displacement
        k = max(range(len(tones)), key=lambda i: tones[i][0] ** 2 * tones[i][1])
        loop, plate, sent = fitted["drive"][k], fitted["accelerometer"][k], self._sent[k]
        # what the coupling capacitor leaves of the tone
        passed = 1.0 / (1.0 - 1j * (profile.drive.highpass_hz or 0.0) / frequencies_hz[k])
        gain = abs(loop / (sent * passed))
        exchanged = self._exchanged(fitted, gain)
        if exchanged is not None:
            return [exchanged]
        remedy = "backend.output_range_v or the drive channel's range_v does not fit; measure both with a voltmeter"
        findings = [Finding("loop-back gain", f"{gain:.4f}", bool(abs(gain - 1.0) <= 0.02), remedy)]
        if gain < 0.1:
            return [*findings, Finding("accelerometer", "not judged without the loop-back", None, remedy)]
        scale = profile.drive.g_per_volt
        if scale is None:
            return findings
        asked = loop * profile.g_mps2.value * (profile.drive.response(tones[k][0]) or 1.0)
        sensitivity = profile.channels.accelerometer
        ratio = plate / sensitivity.volts_per_mps2 / asked
        turned = math.degrees(math.atan2(ratio.imag, ratio.real))
        scales = (scale, sensitivity.sensitivity)
        doubt = math.hypot(*(quantity.uncertainty / quantity.value for quantity in scales))
        # no stricter than what the two calibrations promise together
        off = abs(abs(ratio) - 1.0)
        return [
            *findings,
            Finding(
                "accelerometer sign", f"{turned:+.1f} degrees to the drive", abs(turned) < 60.0,
                "about 180: change channels.accelerometer.sign, or turn its plug; else measure drive.phase_deg",
            ),
            Finding(
                "accelerometer sensitivity", f"{abs(ratio):.4f} of what drive.g_per_volt asks for",
                bool(off <= max(SCALE_OFF, 3.0 * doubt)),
                "calibrate drive.g_per_volt, or channels.accelerometer.sensitivity (by a flip test), again",
            ),
        ]  # fmt: skip

    @property
    def _sent(self) -> tuple[complex, ...]:
        """Drive volts of each tone of the quiet one."""
        return drive_amplitudes(self._profile, QUIET_PEAK / self._per_g)

    def _exchanged(self, fitted: dict[str, Complexes], gain: float) -> Finding | None:
        """Inputs that read what another should: the drive as it was sent, or the plate's motion at the contact's."""
        k = int(np.argmax(np.abs(self._sent)))
        size = {name: abs(amplitudes[k]) / abs(self._sent[k]) for name, amplitudes in fitted.items()}
        scale = self._profile.drive.g_per_volt
        motion = abs(self._profile.channels.accelerometer.volts_per_mps2) * self._profile.g_mps2.value
        asked = motion * scale.value if scale is not None else 0.0  # accelerometer volts a volt of drive
        pair = None
        # off by so much, the drive's input is likely another's; by 2 % only, it is a matter of calibration
        if abs(gain - 1.0) > 0.2:
            pair = next((n for n in size if n != "drive" and abs(size[n] - 1.0) < SCALE_OFF), None), "drive"
        elif size["accelerometer"] < 0.1 * asked and 0.5 * asked < size.get("continuity", 0.0) < 2.0 * asked:
            pair = "continuity", "accelerometer"
        if pair is None or pair[0] is None:
            return None
        seen = f"the {pair[0]} input reads what the {pair[1]} input should"
        return Finding("inputs", seen, False, "change their plugs, or their numbers (terminals) in the profile")

    def _contact(self, rest: dict[str, Floats]) -> list[Finding]:
        """The contact circuit: closed at rest, opening and closing when the ball must fly."""
        channel = self._profile.channels.continuity
        what = "contact circuit"
        if channel is None:
            return []
        gamma = FLIGHT_PEAK / self._per_g
        faults = forbidden(self._profile.limits, plan(self._profile).steps[0], peaks(self._profile, gamma))
        if faults:
            return [Finding(what, f"not judged: {faults[0]}", None, "raise that limit if the rig allows it")]
        hold, heard = self._tone(FLIGHT_PEAK, 0)
        self._instrument = self._measured({name: volts[hold] for name, volts in heard.items()})
        volts, swing_v = heard["continuity"][hold], channel.swing_v
        self._contact_v = float(np.max(np.abs(volts)))
        ac = channel.coupling == "ac"
        middle_v = 0.0 if ac else channel.middle_v
        is_open = (volts - middle_v) * np.sign(swing_v) > 0.0
        edges = int(np.count_nonzero(np.diff(is_open)))
        seen = f"{edges} edges in {HOLD_CYCLES} cycles, open {np.mean(is_open):.0%} of the time"
        # one flight a cycle has two edges; chatter and bounces of a good contact give a few more
        fine = HOLD_CYCLES <= edges <= 6 * HOLD_CYCLES
        remedy = "no edges: a broken wire or no ball; far too many: a dirty contact; see the levels"
        findings = [Finding(what, seen, fine, remedy)]
        if not ac:
            low, high = np.quantile(volts, [0.05, 0.95])
            closed_v, open_v = (low, high) if swing_v > 0 else (high, low)
            worst = max(abs(closed_v - channel.closed_v.value), abs(open_v - channel.open_v.value))
            resting = float(np.median(rest["continuity"]))
            seen = f"closed {closed_v:.2f} V, open {open_v:.2f} V, at rest {resting:.2f} V"
            fine = max(worst, abs(resting - channel.closed_v.value)) < 0.25 * abs(swing_v)
            remedy = "set open_v and closed_v to what a voltmeter reads"
            findings.append(Finding("contact levels", seen, bool(fine), remedy))
        return findings

    def _measured(self, heard: dict[str, Floats]) -> list[Finding]:
        """What the instruments are, from the short flight."""
        profile, n = self._profile, len(heard["accelerometer"])
        forcing = profile.forcing
        step = step_row(
            {"first_sample": 0, "n_samples": n, "frequency_hz": forcing.frequency_hz, "ratio": forcing.ratio}
        )
        read = {name: lambda start, stop, volts=volts: volts[start:stop] for name, volts in heard.items()}
        gaps = np.zeros((0, 2), np.int64)
        found = examine(read, n, profile.sampling.rate_hz, step, gaps, profile.setup())
        return [Finding("instrument", line, True) for line in found.in_words()]

    def _tapped(self) -> Finding:
        """The table's slow mode, which the ball's impacts will feed where it lies below the forcing."""
        rate_hz, forcing_hz = self._profile.sampling.rate_hz, self._profile.forcing.frequency_hz
        found = mode_of_tap(self._play(np.zeros(round(TAP_S * rate_hz)))["accelerometer"], rate_hz)
        if found is None:
            remedy = "hit the resting table once, within the first seconds, so that it rings"
            return Finding("table's mode", f"no tap that rings was seen within {TAP_S:g} s", None, remedy)
        seen = f"{found[0]:.3g} Hz, damping {found[1]:.2g} of critical"
        remedy = "below the forcing the ball's impacts feed it: a heavier or more damped table, a lighter ball"
        return Finding("table's mode", seen, True if found[0] > forcing_hz else None, remedy)

    def _noise(self, rest: dict[str, Floats]) -> list[Finding]:
        """Noise of each channel at rest."""
        channel = self._profile.channels.accelerometer
        findings = []
        for name, volts in rest.items():
            rms_v = float(np.std(volts))
            limit_v = {
                "accelerometer": 0.05 * self._profile.g_mps2.value * abs(channel.volts_per_mps2),
                "drive": 0.01,
            }.get(name, 0.02 * getattr(self._profile.channels, name).range_v)
            seen = f"{1e3 * rms_v:.3g} mV rms (allowed {1e3 * limit_v:.3g})"
            remedy = "shield the cable, mind the grounds; a dead channel has none at all"
            findings.append(Finding(f"noise of {name}", seen, 0.0 < rms_v <= limit_v, remedy))
        return findings

    def _margins(self, quiet: dict[str, Floats]) -> list[Finding]:
        """How far the highest step of the ramp stays from each converter's limit, judged by the quiet tone."""
        highest = max(peaks(self._profile, gamma).gamma_peak for gamma in set(self._profile.ramp.gammas()))
        findings = []
        for name, volts in quiet.items():
            range_v = getattr(self._profile.channels, name).range_v
            if name == "continuity":
                reach_v, where = self._contact_v, "in flight"
            else:
                reach_v = float(np.max(np.abs(volts))) * highest / QUIET_PEAK
                where = f"at gamma_peak {highest:.3g} (impacts not counted)"
            margin_db = 20.0 * math.log10(range_v / max(reach_v, 1e-9))
            seen = f"{margin_db:.1f} dB below {range_v:g} V {where}"
            remedy = "a larger range_v, a lower gain, or a lower ramp"
            # 3 dB are left for impacts, which a tone without a ball does not show
            findings.append(Finding(f"margin of {name}", seen, margin_db >= 3.0, remedy))
        return findings
