"""Scores by effect and by condition of the recording, as Markdown."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.scoring.tables import STRONG, WEAK, covered, names_of, parameters, rate, sets_of, strength, truth_of

Row = dict[str, Any]


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
        strong = [r for r in own if strength(r) >= STRONG]
        weak = [r for r in own if WEAK[0] <= strength(r) <= WEAK[1]]
        checks = [x for r in own if plant == "other" and set(names_of(r)) == truth_of(r) for x in parameters(r)]
        cells = (
            rate(strong, lambda r: bool(truth_of(r) & set(names_of(r)[:1]))),
            rate(weak, lambda r: any(truth_of(r) <= s for s in sets_of(r))),
            rate(checks, lambda x: x["inside"]) if checks else "",
        )
        print(f"| {plant} | {name} | {' | '.join(cells)} |")
    print()


def by_condition(rows: Sequence[Row]) -> None:
    """False alarms and right names by each condition that the design varies."""
    varied = [r for r in rows if r.get("conditions")]
    if not varied:
        return
    print("### By condition\n\n| condition | value | clean: false alarms | strong: named first |\n|---|---|---|---|")
    for name in varied[0]["conditions"]:
        groups = _grouped(varied, lambda r, name=name: r["conditions"][name])  # type: ignore[misc]
        for value, own in sorted(groups.items()):
            clean = [r for r in own if r["kind"] in ("clean", "declared")]
            strong = [r for r in own if r["kind"] == "strong" and not covered(r) and strength(r) >= STRONG]
            alarms = rate(clean, lambda r: r["verdict"] != "nothing_missing")
            print(f"| {name} | {value} | {alarms} | {rate(strong, _first)} |")
    print()


def _first(row: Row) -> bool:
    return bool(truth_of(row) & set(names_of(row)[:1]))


def _grouped(rows: Sequence[Row], key: Callable[[Row], Any]) -> dict[Any, list[Row]]:
    groups: dict[Any, list[Row]] = defaultdict(list)
    for row in rows:
        groups[key(row)].append(row)
    return groups
