"""Choice of the next block of steps: the most information for a second of the rig's time.

Information is counted in nats: about which explanation is true (the mutual information between explanation and data,
by the pairwise bound of Kolchinsky and Tracey), and about the parameters that a person asked for (D-optimality). A
difference counts only as far as calibrations and the rival's own parameters cannot make up for it.

References
----------
G. E. P. Box, W. J. Hill, Technometrics 9, 57 (1967): discrimination among models.
K. Chaloner, I. Verdinelli, Stat. Sci. 10, 273 (1995): Bayesian experimental design; D-optimality.
A. Kolchinsky, B. D. Tracey, Entropy 19, 361 (2017): bounds on the entropy of a mixture, equation 10. Decision 146.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.attribution.fit import Fitter, of_same_events
from analysis.explore.explanations import Explanation, Weighed, slopes_at
from analysis.linear_algebra import inv, lstsq
from analysis.loop.design import HOLD_CYCLES, simulate_steps
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.values import ParameterId
from daq.setup.setup import Setup
from kernels.arrays import Floats

MOST_EXPLANATIONS = 10  # that a block is chosen to separate


@dataclass(frozen=True)
class Option:
    """One forcing with the gammas that the rig's limits allow, up or down."""

    setup: Setup  # with this forcing
    gammas: tuple[float, ...]  # in the order of the run, (m,)
    hold_cycles: int  # cycles for which each step is held
    seconds: Callable[[Sequence[int]], float]  # rig time of a block with the gammas at the given places

    @property
    def rising(self) -> bool:
        """Whether gamma goes up."""
        return len(self.gammas) < 2 or self.gammas[-1] > self.gammas[0]


@dataclass(frozen=True)
class Block:
    """Steps chosen, and why."""

    option: Option  # the forcing
    steps: tuple[int, ...]  # places of the steps among its gammas
    nats: float  # expected information
    seconds: float  # of rig time
    separates: tuple[tuple[str, ...], tuple[str, ...]]  # the two explanations that it separates best, by names
    sharpening: float = 0.0  # part of the information that is about parameters asked for

    @property
    def gammas(self) -> tuple[float, ...]:
        """Of the steps."""
        return tuple(self.option.gammas[i] for i in self.steps)


@dataclass(frozen=True)
class Pool:
    """What the steps of one option would tell."""

    option: Option
    # products of all columns, parameters first (K of them) and then the differences of each explanation from
    # the first, summed over the data of each step, (m, K + E, K + E)
    products: Floats
    flight_s: Floats  # mean time of flight expected in each step, (m,); NaN where the ball stays on the plate

    @classmethod
    def of(cls, option: Option, model: ForwardModel, fitter: Fitter, known: Weighed) -> Pool:
        """Simulate the option's steps under the most probable explanation, and predict them by every other."""
        some = known.explanations[:MOST_EXPLANATIONS]
        truth = some[0].values
        made = ForwardModel(
            simulate_steps(option.setup, np.array(option.gammas), model, truth, carried=True), model.declared
        )
        whitener = Whitener.of(made, truth)
        raw, slopes = slopes_at(made, fitter, whitener, truth, [(key, ()) for key in known.keys])
        columns = [whitener.white_slopes(slopes, raw)]
        columns += [
            whitened_difference(whitener, raw, whitener.stacked(made.residuals(x.values)))[:, None] for x in some
        ]
        every = np.nan_to_num(np.column_stack(columns))
        rows = np.concatenate([whitener.step, made.observations.plate.step])
        events = np.arange(len(rows)) < len(whitener.step)  # as many as are simulated; plate data are a step's already
        every *= np.sqrt(np.where(events, option.hold_cycles / HOLD_CYCLES, 1.0))[:, None]
        products = [every[rows == i].T @ every[rows == i] for i in range(len(option.gammas))]
        flown, step = (
            made.observations.measured.landing_s - made.observations.measured.opening_s,
            made.observations.measured.step,
        )
        means = [float(np.mean(flown[step == i])) if np.any(step == i) else np.nan for i in range(len(option.gammas))]
        return cls(option, np.array(products), np.array(means))


def whitened_difference(whitener: Whitener, raw: Floats, other: Floats) -> Floats:
    """Whitened difference of two predictions (n,), from bare residuals; 0 where one is of another flight.

    A fit cannot follow a flight that becomes another one, and near an edge chance decides which it is.
    """
    change = whitener.white_all(raw + of_same_events(other - raw, whitener)) - whitener.white_all(raw)
    return np.clip(change, -6.0, 6.0)  # sigmas


def bistable(pools: Sequence[Pool], block: Block) -> tuple[float, ...]:
    """Gammas of the block at which the motion reached from below is not the one reached from above."""
    own = next(pool for pool in pools if pool.option is block.option)
    other = [
        pool
        for pool in pools
        if pool.option.setup.forcing == block.option.setup.forcing and pool.option.rising != block.option.rising
    ]
    out = []
    for pool in other:
        there = dict(zip(pool.option.gammas, pool.flight_s.tolist(), strict=True))
        for i in block.steps:
            here, gamma = float(own.flight_s[i]), block.option.gammas[i]
            # motions at one gamma whose mean flight times differ by more than a twentieth are different orbits
            if abs(here / there.get(gamma, np.nan) - 1.0) > 0.05:
                out.append(gamma)
    return tuple(out)


def divergences(total: Floats, known: Weighed, some: Sequence[Explanation]) -> Floats:
    """Expected nats by which explanation i, if true, would beat j, whatever j's own parameters do, (E, E).

    ``total`` is the sum of `Pool.products` over the steps of a block.
    """
    k = len(known.keys)
    out = np.zeros((len(some), len(some)))
    for j, rival in enumerate(some):
        rows, inner = known.known_under(rival)
        inner = inner + total[np.ix_(rows, rows)]
        for i in range(len(some)):
            if i == j:
                continue
            size = total[k + i, k + i] - 2.0 * total[k + i, k + j] + total[k + j, k + j]
            cross = total[rows, k + i] - total[rows, k + j]
            out[i, j] = 0.5 * max(size - cross @ lstsq(inner, cross, rcond=1e-12)[0], 0.0)
    return out


def mutual_information(probability: Floats, divergence: Floats) -> float:
    """Between explanation and data, nats, from pairwise divergences."""
    mixed = np.exp(-divergence) @ probability
    return float(-np.sum(probability * np.log(np.maximum(mixed, 1e-300))))


def sharpened(total: Floats, known: Weighed, wanted: Sequence[ParameterId]) -> float:
    """Nats gained about the parameters ``wanted``: logarithms of the ratio of their deviations before and after."""
    return -sum(float(np.log(sharper(total, known, key))) for key in wanted if key in known.keys)


def sharper(total: Floats, known: Weighed, key: ParameterId) -> float:
    """Deviation of a parameter after data of products ``total``, over that before, under the likeliest explanation."""
    first = known.explanations[0]
    rows, before = known.known_under(replace(first, free=(*first.free, key)))
    some, before = rows.tolist(), before + 1e-9 * np.eye(len(rows))
    own = some.index(known.keys.index(key))
    now, then = (inv(x)[own, own] for x in (before, before + total[np.ix_(some, some)]))
    return float(np.sqrt(then / now))


def sharpest(pools: Sequence[Pool], known: Weighed, key: ParameterId, seconds: float) -> float:
    """As `sharper`, after so much rig time spent on all steps of one option, the best one for it."""
    whole = [
        pool.products.sum(axis=0) * max(seconds, 0.0) / pool.option.seconds(range(len(pool.option.gammas)))
        for pool in pools
    ]
    return min(sharper(total, known, key) for total in whole)


def limits_of(pools: Sequence[Pool], known: Weighed, key: ParameterId) -> tuple[float, tuple[ParameterId, ...]]:
    """How sharp a parameter of the most probable explanation can become, and what limits it.

    The first is its least deviation after any number of steps, over its deviation now; the second are calibrations,
    each of which would at least halve that deviation, were it known exactly.
    """
    rows, before = known.known_under(known.explanations[0])
    some, before = rows.tolist(), before + 1e-9 * np.eye(len(rows))
    own = [known.keys[i] for i in some].index(key)
    every = np.sum([pool.products.sum(axis=0)[np.ix_(some, some)] for pool in pools], axis=0)
    # a thousand times every step on offer is more rig time than there is
    now, then = inv(before), inv(before + 1e3 * every)
    given = then[own, own] - then[own] ** 2 / np.diag(then)  # variance, were the other known
    free = known.explanations[0].free
    limiting = [
        known.keys[i]
        for i, v in zip(some, given, strict=True)
        if known.keys[i] not in free and 4.0 * v < then[own, own]
    ]
    return float(np.sqrt(then[own, own] / now[own, own])), tuple(limiting)


def best_block(
    pools: Sequence[Pool],
    known: Weighed,
    wanted: Sequence[ParameterId],
    steps: int,
    worth: Callable[[Floats], float] | None = None,
) -> Block | None:
    """The block of most nats a second: of each option the best steps one by one, then the best option.

    ``worth`` gives the nats of what a block's products sum to; by default they are about which explanation is true and
    about the parameters ``wanted``. None where nothing that the rig may do would tell anything.
    """
    some = known.explanations[:MOST_EXPLANATIONS]
    probability = np.array([x.probability for x in some])
    probability /= probability.sum()

    def information(total: Floats) -> float:
        nats = mutual_information(probability, divergences(total, known, some)) if len(some) > 1 else 0.0
        return nats + sharpened(total, known, wanted)

    worth = worth or information

    best: Block | None = None
    for pool in pools:
        chosen: list[int] = []
        for _ in range(min(steps, len(pool.option.gammas))):
            rest = [i for i in range(len(pool.option.gammas)) if i not in chosen]
            values = [
                worth(pool.products[[*chosen, i]].sum(axis=0)) / pool.option.seconds(sorted([*chosen, i])) for i in rest
            ]
            chosen.append(rest[int(np.argmax(values))])
        places = tuple(sorted(chosen))
        total = pool.products[list(places)].sum(axis=0)
        nats, seconds = worth(total), pool.option.seconds(places)
        if nats > 0.0 and (best is None or nats / seconds > best.nats / best.seconds):
            about = some[0].names, some[0].names
            if len(some) > 1:  # beyond ten nats two explanations count as separated, however far
                value = np.minimum(divergences(total, known, some), 10.0) * np.outer(probability, probability)
                i, j = np.unravel_index(int(np.argmax(value)), value.shape)
                about = some[int(i)].names, some[int(j)].names
            best = Block(pool.option, places, nats, seconds, about, sharpened(total, known, wanted) / nats)
    return best
