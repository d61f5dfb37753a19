"""Scores by effect and by condition of the recording, as Markdown."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.scoring.tables import STRONG, WEAK, covered, names_of, parameters, rate, sets_of, strength, truth_of

Row = dict[str, Any]

LENGTH = "cycles in all"


def by_effect(rows: Sequence[Row]) -> None:
    """One row an effect: strong ones named first, weak ones in the tie set, intervals that hold the truth."""
    single = [r for r in rows if r["kind"] in ("strong", "weak") and not covered(r)]
    if not single:
        return
    print("### By effect\n")
    print("| plant | hidden | strong, named first | weak, in the tie set | intervals that hold the truth |")
    print("|---|---|---|---|---|")
    groups = _grouped(single, lambda r: (r["plant"], r["hidden"][0]))
    for (plant, name), own in sorted(groups.items()):
        print(f"| {plant} | {name} | {' | '.join(_named(own))} |")
    print()


def by_condition(rows: Sequence[Row]) -> None:
    """False alarms, right names and coverage by each condition that the design varies, and by the length of the run."""
    varied = [r for r in rows if r.get("conditions")]
    if not varied:
        return
    print("### By condition\n")
    print(
        "| condition | value | clean: false alarms | strong, named first | weak, in the tie set "
        "| intervals that hold the truth |"
    )
    print("|---|---|---|---|---|---|")
    for name in (*varied[0]["conditions"], LENGTH):
        groups = _grouped(varied, lambda r, name=name: _condition(r, name))  # type: ignore[misc]
        for value, own in sorted(groups.items()):
            clean = [r for r in own if r["kind"] in ("clean", "declared")]
            single = [r for r in own if r["kind"] in ("strong", "weak") and not covered(r)]
            alarms = rate(clean, lambda r: r["verdict"] != "nothing_missing")
            print(f"| {name} | {value} | {alarms} | {' | '.join(_named(single))} |")
    print()


def _condition(row: Row, name: str) -> Any:
    under = row["conditions"]
    return under["steps"] * under["cycles"] if name == LENGTH else under[name]


def _named(rows: Sequence[Row]) -> tuple[str, str, str]:
    """Strong effects named first, weak ones in the tie set, and intervals that hold the truth."""
    strong = [r for r in rows if strength(r) >= STRONG]
    weak = [r for r in rows if WEAK[0] <= strength(r) <= WEAK[1]]
    checks = [x for r in rows if r["plant"] == "other" and set(names_of(r)) == truth_of(r) for x in parameters(r)]
    return (
        rate(strong, lambda r: bool(truth_of(r) & set(names_of(r)[:1]))),
        rate(weak, lambda r: any(truth_of(r) <= s for s in sets_of(r))),
        rate(checks, lambda x: x["inside"]) if checks else "",
    )


def _grouped(rows: Sequence[Row], key: Callable[[Row], Any]) -> dict[Any, list[Row]]:
    groups: dict[Any, list[Row]] = defaultdict(list)
    for row in rows:
        groups[key(row)].append(row)
    return groups
