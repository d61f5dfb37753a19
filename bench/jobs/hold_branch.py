"""The branch on which a profile's ramp holds the ball: its locked cycle, by the effects that the profile declares."""

from __future__ import annotations

import numpy as np

from daq.setup.errors import InputError
from model.bifurcations.continuation import CycleBranch, cycle_branches
from model.effects.registry import ball_effects
from model.orbits.make_ball import make_ball
from model.tones import Forcing
from rig.execution.branch_hold import BranchHold, LockedBranch
from rig.profile import BranchTable, Profile


def branch_hold(profile: Profile) -> BranchHold:
    """What holds the ball through a ramp, by its ``[control.branch]`` or the defaults (raises as `locked_branch`)."""
    table = (profile.control.branch if profile.control else None) or BranchTable()
    branch = locked_branch(profile)
    known = LockedBranch(branch.gamma, branch.phase[:, 0], branch.multiplier)
    return BranchHold(profile, table, known)


def locked_branch(profile: Profile) -> CycleBranch:
    """The branch of locked cycles of one flight a period that reaches highest in the ramp; raises `InputError`."""
    multiples, displacements = zip(*profile.forcing.displacement_tones(), strict=True)
    forcing = Forcing.of_displacements(multiples, np.array(displacements), from_first=False)
    frequency_hz, g_mps2 = profile.forcing.frequency_hz, profile.g_mps2.value
    ball = make_ball(forcing, ball_effects(profile.declared_values()), frequency_hz=frequency_hz, g_mps2=g_mps2)
    highest = max(profile.ramp.gammas())
    found = [
        branch
        for branch in cycle_branches(ball, 0.1 * highest, 1.02 * highest, 1)
        if branch.periods == 1 and len(branch.gamma) > 2 and abs(branch.multiplier).min() < 1.0
    ]
    if not found:
        raise InputError(
            f"profile {profile.name!r}: up to gamma {highest:g} the ball has no stable locked cycle of one flight a "
            "period from which to be held; raise ramp.gamma, or leave --hold-branch out"
        )
    return max(found, key=lambda branch: float(branch.gamma[-1]))
