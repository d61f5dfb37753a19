"""Rates with Wilson intervals, the confusion matrix, and the coverage of intervals, from the rows of trials.

Strength is measured, not asked for: the largest residual of the declared model over its uncertainty, of landings,
take-offs or any kind of plate datum, noise taken out. The profile's own scales may be off by their stated uncertainty.
Strong is 5 and more, weak 1 to 3.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

from analysis.residuals.plate_data.plate_observables import MODULATION
from benchmarks.scoring.truth import AT_RATIO, OTHER_PARAMETERS, expected_covariate, expected_names

Row = dict[str, Any]

STRONG, WEAK = 5.0, (1.0, 3.0)
MANY = 300  # trials, from which an interval is narrow enough for tenths of a percent


def wilson(k: int, n: int) -> tuple[float, float]:
    """Wilson's 95 % interval of ``k`` in ``n``."""
    if n == 0:
        return 0.0, 1.0
    z, p = 1.96, k / n
    middle, width = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max((middle - width) / (1 + z * z / n), 0.0), min((middle + width) / (1 + z * z / n), 1.0)


def rate(rows: Sequence[Row], hit: Callable[[Row], bool]) -> str:
    """``k of n (low to high)``; of many, to a tenth of a percent; nothing of none."""
    if not rows:
        return ""
    k, n = sum(map(hit, rows)), len(rows)
    low, high = wilson(k, n)
    digits = 1 if n >= MANY else 0
    return f"{k} of {n} ({100 * low:.{digits}f} to {100 * high:.{digits}f} %)"


def strength(row: Row, key: str = "size_left") -> float:
    """Largest residual of the declared model, its scales as far off as the profile allows, in units of the noise.

    Windows count for what swells alone: there are many, and one that an impact has spoilt would decide.
    """
    swells = {"amplitude_modulation", "table_resonance"} & set(row["hidden"])
    return max((x for kind, x in row[key].items() if swells or kind != f"plate {MODULATION}"), default=0.0)


def sets_of(row: Row) -> list[set[str]]:
    """Names of the winner and of all that tie with it."""
    return [set(s) for s in row["tie_set"]] or [set(names_of(row))]


def names_of(row: Row) -> list[str]:
    """Names of the added effects, in order."""
    return [e["name"] for e in row["effects"]]


def truth_of(row: Row) -> set[str]:
    """Expected names of everything hidden."""
    return {name for effect in row["hidden"] for name in expected_names(row["plant"], effect)}


def covered(row: Row) -> bool:
    """Whether what is hidden shows, but is no more than what the profile states of its own scales."""
    return strength(row, "size") >= WEAK[0] > strength(row)


def show(rows: Sequence[Row]) -> None:
    """Everything, as Markdown."""
    failed = [r for r in rows if "failed" in r]
    rows = [r for r in rows if "failed" not in r]
    named = [r for r in rows if r["kind"] in ("strong", "weak") and not covered(r)]
    print(f"{len(rows)} trials, {len(failed)} failed\n")
    for plant in ("other", "own"):
        _rates([r for r in rows if r["plant"] == plant], [r for r in named if r["plant"] == plant], plant)
    _confusion(rows)
    seconds = sorted(r["seconds"] for r in rows)
    if seconds:
        print(f"\nseconds a ramp: median {seconds[len(seconds) // 2]:.0f}, 90 % {seconds[int(0.9 * len(seconds))]:.0f}")
    for r in failed:
        print("failed:", r["job"], r["failed"])


def _rates(rows: Sequence[Row], named: Sequence[Row], plant: str) -> None:
    if not rows:
        return
    strong = [r for r in named if strength(r) >= STRONG]
    weak = [r for r in named if WEAK[0] <= strength(r) <= WEAK[1]]
    middle = [r for r in named if WEAK[1] < strength(r) < STRONG]
    clean = [r for r in rows if r["kind"] in ("clean", "declared")]
    outside = [r for r in rows if r["kind"] == "outside" and strength(r) >= STRONG]
    pairs = [r for r in rows if r["kind"] == "pair"]

    def first(r: Row) -> bool:
        return bool(truth_of(r) & set(names_of(r)[:1]))

    def tied(r: Row) -> bool:
        return any(truth_of(r) <= s for s in sets_of(r))

    def wrong(r: Row) -> bool:
        return bool(names_of(r)) and not any(truth_of(r) & s for s in sets_of(r))

    def exact(r: Row) -> bool:
        return r["verdict"] == "explained" and set(names_of(r)) == truth_of(r)

    def within(key: str, times: float) -> Callable[[Row], bool]:
        return lambda r: (r["after"][key] or math.inf) <= times * r["noise_floor_us"]

    print(f"### {'Another plant' if plant == 'other' else 'The simulated rig'}\n")
    print("| figure | reached (95 % interval) |\n|---|---|")
    for label, some in (("strong", strong), ("between", middle), ("weak", weak)):
        print(f"| {label}: named first | {rate(some, first)} |")
        print(f"| {label}: in the tie set | {rate(some, tied)} |")
        print(f"| {label}: a wrong name alone | {rate(some, wrong)} |")
        print(f"| {label}: exactly the one, explained | {rate(some, exact)} |")
    hidden = [r for r in rows if r["kind"] in ("strong", "weak") and covered(r)]
    print(f"| within the stated scales: nothing missing, or the right name | {rate(hidden, _no_other)} |")
    print(f"| clean: false alarms | {rate(clean, lambda r: r['verdict'] != 'nothing_missing')} |")
    print(f"| outside the library: flagged | {rate(outside, lambda r: r['verdict'] == 'unexplained')} |")
    print(f"| outside: explained though the error is above 1.5 floors | {rate(outside, _clean_bill)} |")
    smooth = [r for r in outside if expected_covariate(plant, r["hidden"][0])]
    print(f"| outside, smooth: covariate named | {rate(smooth, lambda r: _covariate(r, plant))} |")
    print(f"| outside, smooth: error after <= 1.5 floors | {rate(smooth, _term_good)} |")
    print(f"| pairs: the exact set | {rate(pairs, lambda r: set(names_of(r)) == truth_of(r))} |")
    right = [r for r in strong if first(r) and set(names_of(r)) == truth_of(r)]
    print(f"| after: landing rms <= 1.3 floors | {rate(right, within('landing_rms_us', 1.3))} |")
    print(f"| after: robust value <= 1.2 floors | {rate(right, within('landing_nmad_us', 1.2))} |")
    if plant == "other":
        single = [r for r in named if set(names_of(r)) == truth_of(r)]
        checks = [x for r in single for x in parameters(r)]
        print(f"| intervals that hold the truth | {rate(checks, lambda x: x['inside'])} |")
        print(f"| parameters within 5 % or 2 sigma | {rate(checks, lambda x: x['inside'] or x['off'] < 0.05)} |")
    print()


def parameters(row: Row) -> list[Row]:
    """Found parameters against the truth (the other plant alone keeps it in comparable numbers)."""
    tables = {e["name"]: e["parameters"] for e in row["effects"]}
    out = []
    for key, value in row["truth"].items():
        for effect, parameter, factor in OTHER_PARAMETERS.get(key, ()):
            found = tables.get(effect, {}).get(parameter)
            if found is not None and value:
                true = value * factor * AT_RATIO.get(row["c"], {}).get(key, 1.0)
                out.append({
                    "key": key, "off": abs(found["value"] / true - 1.0),
                    "inside": found["low"] <= true <= found["high"], "truth": true, "found": found,
                })  # fmt: skip
    return out


def _no_other(row: Row) -> bool:
    """Nothing is said to be missing, or what was hidden is."""
    return row["verdict"] == "nothing_missing" or bool(truth_of(row) & set(names_of(row)[:1]))


def _clean_bill(r: Row) -> bool:
    return r["verdict"] == "explained" and (r["after"]["landing_rms_us"] or 0.0) > 1.5 * r["noise_floor_us"]


def _covariate(r: Row, plant: str) -> bool:
    return r["discovered"] is not None and r["discovered"]["covariate"] == expected_covariate(plant, r["hidden"][0])


def _term_good(r: Row) -> bool:
    d = r["discovered"]
    return d is not None and d["rms_us"] <= 1.5 * d["floor_us"]


def _confusion(rows: Sequence[Row]) -> None:
    print("### Confusion matrix\n\n| kind | plant | hidden | named | verdict | n |\n|---|---|---|---|---|---|")
    table = Counter(
        (r["kind"], r["plant"], " + ".join(r["hidden"]) or "-", " + ".join(names_of(r)) or "-", r["verdict"])
        for r in rows
    )
    for key, n in sorted(table.items()):
        print(f"| {' | '.join(key)} | {n} |")
