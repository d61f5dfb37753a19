"""A plan that breaks something, made as small as it can be."""

from __future__ import annotations

from dataclasses import replace

from benchmarks.bench_simulation.disk import Disk
from benchmarks.bench_simulation.judge import simulate
from benchmarks.bench_simulation.plan import Plan


def shrunk(plan: Plan, broken: list[str], disk: Disk) -> tuple[Plan, list[str]]:
    """The plan with as few faults and steps as still break something, and what they break."""

    def tried(smaller: Plan) -> bool:
        nonlocal plan, broken
        found = simulate(smaller, disk)[0]
        if found:
            plan, broken = smaller, found
        return bool(found)

    k = 0
    while k < len(plan.faults):
        k += not tried(plan.without(k))
    for plain in (
        {"gammas": plan.gammas[:1]}, {"settle_cycles": 0}, {"hold_cycles": 1}, {"counter": 0}, {"begin_ns": 0},
        {"drift": 0.0}, {"recorder": "here"}, {"is_controlled": False}, {"drive_limit_v": 9.5},
    ):  # fmt: skip
        if plan.device == "plain" or "recorder" not in plain:
            tried(replace(plan, **plain))
    return plan, broken
