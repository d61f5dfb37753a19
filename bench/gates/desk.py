"""The six gates in the page's process: one state that all browsers see and the holder of the controls changes."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from bench.gates.state import GATES, Inputs, Message, Passed, Result, State, now, save_state, scales_of, view_of
from bench.gates.work import KINDS, Job, row_of, work
from bench.live.pages import Desk, desk_of
from bench.live.processes import asked_of
from bench.live.watched_run import SILENT_S
from bench.profiles.edit import fields_of, value_of, with_values
from bench.profiles.find import refuse_forbidden, scenario_names
from bench.profiles.improved import profile_in, with_preset
from bench.terminal.run_console import spawned
from bench.web.browsers import Browser, socket_route
from bench.web.serve import Place, Section, templates_of
from daq.files.disk import write_whole
from daq.recording import verify
from daq.setup.errors import InputError
from daq.setup.values import read_toml_text
from rig.profile import parse_profile

HERE = Path(__file__).parent


class Gates(Passed):
    """The six gates of one rig, and what they start; ``offered``: a profile, taken where none was chosen yet."""

    def __init__(self, folder: Path, live: Desk, offered: str | None) -> None:
        super().__init__(folder)
        self.live, self._offered = live, offered
        self._pipe: Any = None
        self._process: Any = None
        self._tried: Inputs = {}  # what the job began with

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Look after jobs and runs while the server runs."""
        self.read_profile()
        if self._offered is not None and not self.state.profile:
            lost = self.fault
            try:
                self._choose({"like": self._offered})
                self.fault = self.fault or lost
            except (InputError, OSError) as error:
                self.fault = f"{lost}\n{error}".strip()
        if self.state.run is not None:  # of a server that died
            self.live.attach(self.state.run)
        ticking = asyncio.create_task(self._tick_for_ever())
        try:
            yield
        finally:
            ticking.cancel()
            if self._process is not None:
                self._process.terminate()

    async def _tick_for_ever(self) -> None:
        while True:
            try:
                self._look_at_job()
                self._look_at_run()
            except (InputError, OSError) as error:  # the disk refuses: the run's end is looked at again
                if self.fault != str(error):
                    self.fault = str(error)
                    self.tell()
            await asyncio.sleep(0.1)

    async def talk(self, browser: Browser) -> None:
        """Serve one browser until it is gone."""
        browser.words_only = True
        await self.live.hub.serve(browser, self._greet, self._obey)

    async def _greet(self, browser: Browser) -> None:
        browser.send(json.dumps(view_of(self)))

    def tell(self) -> None:
        """Show the state to every browser."""
        self.live.hub.tell(view_of(self))

    def _obey(self, browser: Browser, said: Message) -> None:
        """Do what a browser asks: the lease and stops are the live page's, all else is for who holds the controls."""
        commands: dict[str, Callable[[Message], None]] = {
            "choose": self._choose, "job": self._start_job, "answer": self._answer, "accept": self._accept,
            "set": self._set, "undo": self._undo, "preset": self._preset, "start": self._start_run,
            "again": self._again, "exchange": self._exchange, "turn": self._turn, "later": self._later,
            "now": self._end_job,
        }  # fmt: skip
        do = str(said.get("do"))
        if do == "now" or do not in commands:
            self.live.obey(browser, said)
        if do not in commands:
            return
        refusal = ""
        try:
            if do != "now" and not self.live.hub.lease.may(browser.name):
                raise InputError("another browser holds the controls")
            commands[do](said)
        except (InputError, OSError) as error:
            refusal = str(error)
        self.tell()
        if refusal:
            browser.send(json.dumps({"kind": "refused", "why": refusal}))

    # the profile

    def _keep(self, state: State) -> None:
        """Take over a state, once it is on the disk."""
        save_state(self.folder, state)
        self.state = state

    def _choose(self, said: Message) -> None:
        """Take a profile of the folder, or make one like a shipped one, a file or a recording's."""
        self._refuse_busy()
        scenario, seed, name = str(said.get("scenario", "")), said.get("seed", 0), str(said.get("profile", ""))
        if scenario not in ("", *scenario_names()) or not isinstance(seed, int) or not 0 <= seed < 10**9:
            raise InputError("the simulated rig: expected one of its scenarios, and a whole number as its seed")
        if like := str(said.get("like", "")):
            name = profile_in(self.folder, like)
        if name not in self.profiles():
            raise InputError(f"{name or 'no name'}: no such profile in {self.folder}; choose one of the list")
        undo = self.state.undo if name == self.state.profile else ()
        self._keep(replace(self.state, profile=name, scenario=scenario, seed=seed, undo=undo, queue=(), rounds=()))
        self.read_profile()

    def _write(self, text: str, undo: tuple[str, ...] | None = None) -> None:
        """Replace the profile by one that is checked; what it was can be had again by undo."""
        self._refuse_busy()
        parse_profile(text, self.state.profile)
        before = read_toml_text(self.path)
        write_whole(self.path, text)
        undo = (*self.state.undo, before)[-20:] if undo is None else undo  # 20 changes can be undone
        self._keep(replace(self.state, undo=undo))
        self.read_profile()

    def _change(self, values: Message) -> None:
        self._write(with_values(read_toml_text(self.path), values, self.state.profile))

    def _set(self, said: Message) -> None:
        """A key of the profile, as the person typed it."""
        key = str(said.get("key", ""))
        self._change({key: value_of(key, str(said.get("text", "")))})

    def _undo(self, said: Message) -> None:
        if self.state.undo:
            self._write(self.state.undo[-1], self.state.undo[:-1])

    def _preset(self, said: Message) -> None:
        self._write(with_preset(read_toml_text(self.path), str(said.get("name", "")), self.state.profile))

    def _exchange(self, said: Message) -> None:
        """Exchange the input numbers of the contact circuit and the accelerometer."""
        inputs = getattr(self._known().backend, "inputs", None)
        if inputs is None:
            raise InputError("backend.inputs: this back end has no numbered inputs; exchange the plugs")
        pair = {"continuity": inputs.accelerometer, "accelerometer": inputs.continuity}
        self._change({f"backend.inputs.{name}": number for name, number in pair.items()})

    def _turn(self, said: Message) -> None:
        """Turn the accelerometer's sign."""
        self._change({"channels.accelerometer.sign": -self._known().channels.accelerometer.sign})

    # jobs of the gates

    def _refuse_busy(self) -> None:
        if self.job is not None or self.live.busy:
            raise InputError("something is under way; wait for its end, or stop it")

    def _refuse_closed(self, gate: str) -> None:
        """Refuse a gate while something else is under way, or one before it is not green."""
        self._refuse_busy()
        self.read_profile()  # an editor may have changed the file
        self._known()
        for before in GATES[: GATES.index(gate)]:
            if not self.is_green(before):
                raise InputError(f"{gate}: closed until {before} is green")

    def _start_job(self, said: Message) -> None:
        """Do what a gate does, in a process of its own."""
        gate, kind = str(said.get("gate", "")), str(said.get("kind", ""))
        if kind not in KINDS.get(gate, ()):
            raise InputError(f"{gate} {kind}: no such work")
        self._refuse_closed(gate)
        recording = improved = None
        if gate == "verdict":
            recording = self.folder / self.state.results["ramp"].file
            stem = self.path.stem.partition("-improved")[0]
            names = (self.folder / f"{stem}-improved-{n}.toml" for n in count(1))
            improved = next(path for path in names if not path.exists())
        rig = self.rig
        scenario = Path(rig["scenario"]) if rig.get("scenario") else None
        job = Job(gate, kind, self.path, scenario, rig.get("seed", 0), recording, improved)
        self._pipe, self._process = spawned(work, job, name=gate)  # no daemon: it may record
        self.job = {"gate": gate, "kind": kind, "words": "", "asks": False}
        self._tried = {} if gate == "verdict" else self.inputs(gate)

    def _answer(self, said: Message) -> None:
        """A person has done what was asked."""
        if self.job is not None and self.job["asks"]:
            self.job |= {"asks": False, "words": ""}
            with contextlib.suppress(OSError):
                self._pipe.send(True)

    def _end_job(self, said: Message) -> None:
        """End the job that is being done; anyone may."""
        if self.job is not None:
            self._process.terminate()
            self._process.join(3.0)  # a drive is faded first
            self._conclude({"error": "stopped by hand"})

    def _look_at_job(self) -> None:
        """Take in what the process of a job says."""
        while self.job is not None:
            try:
                if not self._pipe.poll():
                    return
                what, answer = self._pipe.recv()
            except (EOFError, OSError):
                what, answer = "done", {"error": "it ended with an error of its own; see the terminal"}
            if what == "done":
                self._conclude(answer)
            else:
                self.job |= {"words": answer, "asks": what == "ask"}
                self.tell()

    def _conclude(self, answer: Message) -> None:
        """The outcome of a job becomes the result of its gate."""
        job, self.job = self.job or {}, None
        self.read_profile()  # a calibration has changed it
        gate, state = job["gate"], replace(self.state, device=answer.get("device", self.state.device))
        if self.profile is None:
            self.tell()
            return
        rows = list(answer.get("rows", []))
        if answer.get("error"):
            rows.append(row_of(job["kind"] or gate, answer["error"], False))
        inputs, passed = self._tried, all(row["passed"] is not False for row in rows)
        if gate == "wiring" and job["kind"] != "drive":  # both moves have to be answered, by the same wires
            before = state.results.get("wiring")
            rows = [*(before.rows if before is not None and before.inputs == inputs else ()), *rows]
            rows = list({row["what"]: row for row in rows}.values())
            done = {row["what"].partition(":")[0] for row in rows if row["passed"]}
            passed = {"tap", "lift"} <= done and all(row["passed"] is not False for row in rows)
        if gate == "calibrate":  # passed when a person takes what is now in the profile
            passed, inputs = False, self.inputs(gate)
        result = Result(passed, inputs, now(), tuple(rows))
        if gate == "verdict" and "round" in answer:
            result = replace(result, file=answer["round"]["recording"])
            others = [one for one in state.rounds if one["recording"] != result.file]
            state = replace(state, rounds=(*others, answer["round"]))
        self._keep(state.passed(gate, result))
        self.tell()

    def _accept(self, said: Message) -> None:
        """The person takes the scales as they are; old or missing ones only when that is said."""
        self._refuse_closed("calibrate")
        profile = self._known()
        doubtful = ", ".join(row["key"] for row in scales_of(profile) if row["state"] != "good")
        if doubtful and said.get("anyway") is not True:
            raise InputError(f"{doubtful}: not calibrated, or long ago; calibrate, or say that you take them")
        inputs = self.inputs("calibrate")
        self._keep(self.state.passed("calibrate", Result(True, inputs, now())))

    # runs

    def _start_run(self, said: Message) -> None:
        """Drive the ramp that the page shows."""
        self._refuse_closed("ramp")
        if said.get("hands_off") is not True:
            raise InputError("say first that all hands are off the plate")
        self._drive(said)

    def _drive(self, said: Message) -> None:
        seed = self.state.seed + len(self.state.rounds)  # a second run has other noise
        asked = asked_of(said, self.folder, Path(self.state.profile).stem, seed)
        inputs = self.inputs("ramp")
        refuse_forbidden(self.state.profile, self._known())
        run = self.live.start(self.path, self.rig.get("scenario") or None, asked)
        self._keep(replace(self.state, run=run | {"inputs": inputs}))

    def _later(self, said: Message) -> None:
        """Put the ramp into the queue once more, or empty the queue."""
        times = said.get("times")
        if times == 0:
            self._keep(replace(self.state, queue=()))
        elif self.state.run is None or len(self.state.queue) >= 20:
            raise InputError("the queue takes up to twenty repetitions of a ramp that is being driven")
        else:
            self._keep(replace(self.state, queue=(*self.state.queue, {"note": str(said.get("note", ""))[:200]})))

    def _look_at_run(self) -> None:
        """The end of a run is the result of the ramp's gate; the next of the queue follows one that was complete."""
        if self.state.run is None or self.live.busy:
            return
        run, ended = self.state.run, self.live.outcome_of(self.state.run["out"])
        out = self.folder / run["out"]
        if ended is None:  # the page was away at the end, or steps chosen by hand have followed
            how = verify(out).state if out.is_file() else "failed"
            if how == "incomplete" and time.time() - out.stat().st_mtime < SILENT_S:
                return  # it goes on, and cannot be watched
            ended = {"how": how, "why": "" if how == "complete" else f"{out.name} is {how}"}
        is_there = out.is_file()
        passed = is_there and ended["how"] in ("complete", "stopped")
        rows = (row_of("ramp", f"{ended['how']} {ended['why']}".strip(), passed),)
        result = Result(passed, run["inputs"], now(), rows, out.name if is_there else "")
        queue = self.state.queue
        self._keep(replace(self.state.passed("ramp", result), run=None, queue=queue[1:]))
        self.read_profile()
        try:
            if queue and (ended["how"] != "complete" or not self.is_green("ramp")):
                raise InputError("the run before was not complete, or the rig has changed since")
            if queue:
                self._drive(queue[0])
        except (InputError, OSError) as error:  # none of the queue is driven, and the ramp's rows say why
            all_rows = (*result.rows, row_of("once more", f"{len(queue)} not driven: {error}", None))
            self._keep(replace(self.state.passed("ramp", replace(result, rows=all_rows)), queue=()))
        self.tell()

    def _again(self, said: Message) -> None:
        """Take the improved profile of the last verdict, to drive it."""
        self._refuse_busy()
        name = str(self.state.rounds[-1]["improved"]) if self.state.rounds else "no verdict yet"
        if name not in self.profiles():
            raise InputError(f"{name}: no improved profile in {self.folder}; close the loop again")
        self._keep(replace(self.state, profile=name, undo=()))
        self.read_profile()


def section(place: Place) -> Section:
    """The page, the profile's keys, and the socket; ``place.options["gates"]["offered"]``: a profile to begin with."""
    gates = Gates(place.folder, desk_of(place), place.options.get("gates", {}).get("offered"))
    templates = templates_of(HERE / "templates")

    async def show(request: Request) -> Response:
        return templates.TemplateResponse(request, "gates.html")

    def fields(request: Request) -> Response:
        """Every key of the profile, with its value, unit, limits and help."""
        if not gates.state.profile:
            raise HTTPException(404, "no profile is chosen")
        return JSONResponse({"fields": fields_of(read_toml_text(gates.path))})

    routes = [Route("/gates", show), Route("/gates/fields", fields), socket_route("/gates/socket", gates.talk)]
    return Section("gates", "Start", "/gates", routes, HERE / "static", gates.running)
