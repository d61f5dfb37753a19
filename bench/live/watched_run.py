"""One run as its page sees it: events, scope and the analyst's results, turned into messages for browsers."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.report.wording import gamma_scale
from bench.live.analyst import analyse
from bench.live.board import Board, Message
from bench.live.scope_data import MOST_BINS_PER_S, MinMax, PlateHeight, flights_piece, scope_piece, spectrum_piece
from bench.terminal.run_console import spawned
from daq.files.json_values import json_object
from daq.files.tables import Block
from daq.recorder.shared_ring import RingReader
from rig.profile import Profile
from rig.programme.ramp import peaks, plan
from rig.programme.sequencer import STILL

LIMIT_UNITS = {"drive_v": "V", "plate_mps2": "m/s\u00b2", "velocity_mps": "m/s", "displacement_m": "m"}
STANDING = tuple(state.value for state in STILL)
SILENT_S = 20.0  # a run says something twenty times a second
Tell = Callable[..., None]


class WatchedRun:
    """A run that is being watched; ``tell`` sends browsers a mapping or bytes, ``passing`` what a late one may miss."""

    def __init__(self, profile: Profile, board: Board, tell: Tell) -> None:
        self.profile, self.board, self._tell = profile, board, tell
        self.successor: Message | None = None  # board, profile (path) and reason of the run that follows, if announced
        self.ended: Message | None = None  # ``how``, ``why`` and ``n_samples``; None while it is under way
        self.out = ""  # name of the recording, empty before there is one
        self._heard_at = time.monotonic()
        self._latest: dict[str, str] = {}  # the last message of each kind
        self._models: list[str] = []
        self._steps: dict[int, tuple[bytes, str]] = {}
        self._taken: list[str] = []
        self._stands = False  # the drive was cut or is over: the plate's displacement is not known any more
        self._ring: RingReader | None = None
        self._factor = gamma_scale(profile.forcing, profile.forcing.ratio).factor
        self._next_sample = -1
        self._shifted = 0  # samples lost so far
        self._recent: list[NDArray[np.int16]] = []
        self._bins = np.zeros((0, 2, 0), np.int16)  # of the scope, not sent yet
        self._bins_end = 0  # samples before the end of the last one, lost ones counted
        self._spectrum_at = 0.0
        self._pipe, self._analyst = spawned(analyse, board.name, profile, True, name="analyst", daemon=True)
        self._say(self._plan())

    @property
    def is_silent(self) -> bool:
        """Whether the run has said nothing for so long that its process must be gone, or has ended without another."""
        # two seconds after a run has ended nothing follows it
        return time.monotonic() - self._heard_at > (SILENT_S if self.ended is None else 2.0)

    def command(self, command: Message) -> None:
        """Pass a command to the run."""
        self.board.commands.put(command)

    def history(self) -> list[str | bytes]:
        """All that a browser needs which opens the page now."""
        out: list[str | bytes] = [*self._latest.values(), *self._models, *self._taken]
        for piece, words in self._steps.values():
            out += [piece, words]
        return out

    def tick(self) -> None:
        """Take in what is new and tell it."""
        for event in self.board.events.read()[0]:
            self._heard_at = time.monotonic()
            self._take_in(event)
        if self._ring is not None:
            if blocks := self._ring.read():
                self._read_frames(blocks)
            self._send_bins(len(self._bins) // 2)
        self._read_analyst()

    def close(self, *, leave: bool = False) -> None:
        """Let go of shared memory and the analyst; ``leave``: the run goes on, and another page may watch it."""
        self._analyst.terminate()
        self._analyst.join(2.0)
        self._pipe.close()
        if self._ring is not None:
            self._ring.close()
        self.board.close(leave=leave)

    def _say(self, message: Message) -> None:
        """Tell a message and keep it for browsers that come later."""
        self._latest[message["kind"]] = json.dumps(message)
        self._tell(message)

    def _plan(self) -> Message:
        """What is known before the run begins."""
        profile = self.profile
        scale, programme = gamma_scale(profile.forcing, profile.forcing.ratio), plan(profile)
        limits = profile.limits
        return {
            "kind": "plan",
            "profile": profile.name,
            "description": profile.description,
            "gammas": [round(step.gamma * scale.factor, 5) for step in programme.steps],
            "factor": scale.factor,
            "axis": "\u0393 peak = max(\u2212a)/g" if scale.name == "gamma_peak" else "\u0393 = A\u03c9\u00b2/g",
            "frequency_hz": profile.forcing.frequency_hz,
            "ratio": profile.forcing.ratio,
            "rate_hz": profile.sampling.rate_hz,
            "duration_s": programme.n_samples / programme.rate_hz,
            "limits": {name: [getattr(limits, name), unit] for name, unit in LIMIT_UNITS.items()},
            "contact_cycles": limits.contact_cycles,
            "declared": sorted(profile.declared_values()),
        }

    def _take_in(self, event: Message) -> None:
        kind = event["kind"]
        if kind == "run":
            if not self.out:  # said again for an analyst that came late
                self._begin(event)
        elif kind == "taken":
            event["at"] = time.time()
            # a browser that opens the page late gets the last 200 commands
            self._taken = [*self._taken[-199:], json.dumps(event)]
            self._tell(event)
        elif kind == "ended":
            self.ended = event
            self._say(event | {"at": time.time(), "out": self.out if event["n_samples"] else None})
        elif kind == "next":
            self.successor = event
        elif kind == "state":
            self._stands = event["state"] in STANDING
            self._say(event)

    def _begin(self, event: Message) -> None:
        """The run tells where its frames are."""
        profile, channels = self.profile, event["channels"]
        self.out = event["out"].replace("\\", "/").rsplit("/", 1)[-1]
        self._channels = list(channels)
        self._rate_hz = profile.sampling.rate_hz
        self._accelerometer = channels.index("accelerometer")
        self._mps2 = event["scales"]["accelerometer"][0] / profile.channels.accelerometer.volts_per_mps2
        largest_m = peaks(profile, max(profile.ramp.gammas())).displacement_m or 1e-3
        # 30000 of the 65536 codes span the plate's way at the ramp's largest gamma: the rest is room for more
        self._least_m = 2.0 * largest_m / 30000.0
        self._height = PlateHeight(self._rate_hz, profile.forcing.frequency_hz, self._mps2, self._least_m)
        self._bin = max(1, int(np.ceil(self._rate_hz / MOST_BINS_PER_S)))
        self._extremes = MinMax(self._bin, len(channels) + 1)
        self._bins = np.zeros((0, 2, len(channels) + 1), np.int16)
        self._say({**event, "out": self.out, "traces": self._traces(event), "at": time.time()})
        with contextlib.suppress(OSError):  # over before it was looked at
            self._ring = RingReader(*event["ring"])

    def _traces(self, event: Message) -> list[Message]:
        """Name, volts and SI of each trace of the scope: ``value = code * scale + offset``."""
        profile, out = self.profile, []
        for name in event["channels"]:
            scale, offset = event["scales"][name]
            si = {"scale": scale, "offset": offset, "unit": "V"}
            channel = profile.channels.get(name)
            if channel is not None and (to := channel.scale()) is not None:
                si = {"scale": scale * to.per_volt, "offset": (offset - to.zero_v) * to.per_volt, "unit": to.unit}
            elif name == "drive" and profile.drive.g_per_volt is not None:
                per_volt = profile.drive.g_per_volt.value * profile.g_mps2.value
                si = {"scale": scale * per_volt, "offset": offset * per_volt, "unit": "m/s\u00b2 asked"}
            out.append({"name": name, "volts": {"scale": scale, "offset": offset, "unit": "V"}, "si": si})
        height = {"scale": 1e3 * self._least_m, "offset": 0.0, "unit": "mm"}
        out.append({"name": "plate height", "volts": height, "si": height})
        return out

    def _send_bins(self, n: int) -> None:
        """Send the first ``n`` bins of the scope that wait, or all where few would be left.

        Half of them at each tick: a run hands frames over when their losses are settled, 1.3 cycles at a time, and a
        scope that got them as they come would stand still between.
        """
        bin_s = self._bin / self._rate_hz
        # a hundredth of a second of the scope is not held back
        if (len(self._bins) - n) * bin_s < 0.01:
            n = len(self._bins)
        if n:
            first_s = self._bins_end / self._rate_hz - len(self._bins) * bin_s
            self._tell(scope_piece(first_s, bin_s, self._bins[:n]), passing=True)
            self._bins = self._bins[n:]

    def _read_frames(self, blocks: Sequence[Block]) -> None:
        """Add new frames to the bins of the scope, and send the spectrum once a second."""
        for block in blocks:
            if block.first_sample != self._next_sample or block.lost_before:
                self._send_bins(len(self._bins))
                self._extremes.clear()
                self._shifted += block.lost_before
                self._bins_end = block.first_sample + self._shifted
            height = self._height.add(np.ascontiguousarray(block.codes[:, self._accelerometer]))
            if self._stands:
                height[:] = -32768  # the code of a height that is not known
            found = self._extremes.add(np.column_stack([block.codes, height]))
            self._next_sample = block.first_sample + len(block.codes)
            self._bins_end += len(found) * self._bin
            self._bins = np.concatenate([self._bins, found])
            self._recent.append(np.ascontiguousarray(block.codes[:, self._accelerometer]))
        now = time.monotonic()
        if now - self._spectrum_at > 1.0:
            recent = np.concatenate(self._recent)[-(1 << 15) :]
            self._recent, self._spectrum_at = [recent], now
            if len(recent) >= 1024:
                self._tell(spectrum_piece(self._rate_hz, recent * self._mps2), passing=True)

    def _read_analyst(self) -> None:
        """What the analyst has found."""
        while True:
            try:
                if not self._pipe.poll():
                    return
                message: dict[str, Any] = self._pipe.recv()
            except (EOFError, OSError):
                return  # it is done, or gone: the page goes on without
            if message["kind"] == "ready":
                if self.out:  # where the run's frames are may have been said too long ago to be read
                    self.command({"do": "announce"})
            elif message["kind"] == "flights":
                piece = flights_piece(message, self._factor)
                words = json_object(
                    {key: message[key] for key in ("step", "final", "asked", "label", "tones", "gamma")}
                )
                words["kind"] = "reduced"
                self._steps[message["step"]] = piece, json.dumps(words)
                self._tell(piece)
                self._tell(words)
            elif message["kind"] == "model":
                self._models.append(json.dumps(message))
                self._tell(message)
            else:
                self._say(message)
