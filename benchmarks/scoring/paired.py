"""Two versions of the code on the same trials: what got better, and what got worse.

Only trials that both have run are counted, so chance in the choice of trials drops out. The test is the exact one for
matched pairs (Q. McNemar, Psychometrika 12, 153, 1947).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from scipy.stats import binomtest

from benchmarks.scoring.tables import covered, names_of, sets_of, truth_of

Row = dict[str, Any]


def right(row: Row) -> bool:
    """Whether the verdict is what it should be for this kind of trial."""
    if "failed" in row:
        return False
    if row["kind"] in ("clean", "declared"):
        return bool(row["verdict"] == "nothing_missing")
    if row["kind"] == "outside":
        return bool(row["verdict"] == "unexplained")
    if covered(row):
        return row["verdict"] == "nothing_missing" or bool(truth_of(row) & set(names_of(row)[:1]))
    return bool(row["verdict"] == "explained") and set(names_of(row)) == truth_of(row)


def tied(row: Row) -> bool:
    """Whether the truth is in the tie set."""
    return "failed" not in row and any(truth_of(row) <= s for s in sets_of(row))


def compare(old: Mapping[str, Row], new: Mapping[str, Row]) -> None:
    """Print the comparison as Markdown."""
    both = [key for key in old if key in new]
    print(f"{len(both)} trials that both versions ran\n")
    print("| figure | before | after | better | worse | p |\n|---|---|---|---|---|---|")
    kinds = dict.fromkeys(old[key].get("kind", "") for key in both)
    tests: list[tuple[str, Callable[[Row], bool]]] = [("right", right), ("truth in the tie set", tied)]
    for kind in filter(None, kinds):
        keys = [key for key in both if old[key].get("kind") == kind]
        for words, hit in tests[: 1 if kind in ("clean", "declared", "outside") else 2]:
            a, b = [hit(old[k]) for k in keys], [hit(new[k]) for k in keys]
            better, worse = (sum(x < y for x, y in zip(p, q, strict=True)) for p, q in ((a, b), (b, a)))
            p = binomtest(better, better + worse).pvalue if better + worse else 1.0
            n = len(keys)
            print(f"| {kind}: {words} | {sum(a)} of {n} | {sum(b)} of {n} | {better} | {worse} | {p:.2g} |")
    for key in both:
        if right(old[key]) != right(new[key]):
            a, b = (_told(rows[key]) for rows in (old, new))
            print(f"\n{'better' if right(new[key]) else 'WORSE'}: {key}: {a} -> {b}", end="")
    ratios = sorted(new[k]["seconds"] / old[k]["seconds"] for k in both if "seconds" in old[k] and "seconds" in new[k])
    if ratios:
        print(f"\n\nseconds, after over before: median {ratios[len(ratios) // 2]:.2f}")


def _told(row: Row) -> str:
    return str(row["failed"]) if "failed" in row else f"{' + '.join(names_of(row)) or 'nothing'} ({row['verdict']})"
