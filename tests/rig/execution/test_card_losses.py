"""The account of a device that lags behind its drive and declares its own losses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from daq.files.tables import Block
from rig.execution.loss_account import LossAccount
from rig.profile import Profile

LAG, SCALE = 60, 1e-3


def run(account: LossAccount, losses: dict[int, int], blocks: int = 40) -> list[Block]:
    """A sine played in blocks of 100, heard `LAG` frames later; before block k, ``losses[k]`` samples are gone."""
    drive = np.sin(2 * np.pi * np.arange(100 * blocks) / 79.0)
    heard = np.concatenate([np.zeros(LAG), drive])
    out: list[Block] = []
    given = 0
    for k in range(blocks):
        account.played(drive[100 * k : 100 * (k + 1)])
        lost = losses.get(k, 0)
        codes = np.rint(heard[100 * k + lost : 100 * (k + 1), np.newaxis] / SCALE).astype(np.int16)
        out += account.heard(Block(given, codes, lost_before=lost), 100)
        given += len(codes)
    return out + account.flush()


def test_steps_lie_where_their_drive_was_heard(make_profile: Callable[..., Profile]) -> None:
    """A played sample is recorded `LAG` frames later; after a declared loss, earlier by what was lost."""
    account = LossAccount(make_profile(), 0, (SCALE, 0.0))
    account.lags(LAG)
    blocks = run(account, {10: 30})
    assert account.lost_samples == 30 == sum(block.lost_before for block in blocks)
    assert sum(len(block.codes) for block in blocks) == 3970 and account.expected_samples == 4000
    assert account.recorded(500) == 560 and account.recorded(2000) == 2030
    assert account.recorded(1000 - LAG) == 1000  # the first sample lost: the next one recorded
    assert account.next_sample == 4000 - LAG


def test_a_short_block_is_no_loss_of_its_own(make_profile: Callable[..., Profile]) -> None:
    """A device that declares may give frames late: nothing is counted that it did not declare."""
    account = LossAccount(make_profile(), 0, (SCALE, 0.0))
    account.lags(LAG)
    account.played(np.zeros(200))
    account.heard(Block(0, np.zeros((40, 1), np.int16)), 100)
    account.heard(Block(40, np.zeros((160, 1), np.int16)), 100)
    account.flush()
    assert account.lost_samples == 0 and account.expected_samples == 200


@pytest.mark.parametrize("counted", [True, False])
def test_a_late_program_is_no_lost_period(make_profile: Callable[..., Profile], counted: bool) -> None:
    """The drive ran dry while the program was kept from running for one of its periods: nothing is declared as lost.

    Where the driver's own count says so, a late clock does not matter; without the count it would.
    """
    profile = make_profile()
    account = LossAccount(profile, 0, (SCALE, 0.0))
    account.lags(3 * LAG)
    rate_hz = profile.sampling.rate_hz
    drive = np.sin(2 * np.pi * np.arange(6000) / 79.0)
    heard = np.concatenate([np.zeros(3 * LAG), drive])
    heard[3000:3060] = 0.0
    for k in range(60):
        account.played(drive[100 * k : 100 * (k + 1)])
        due_ns = round(1e9 * (100 * k + 1000) / rate_hz)
        late_ns = round(79e9 / rate_hz) if 30 <= k < 36 else 0
        codes = np.rint(heard[100 * k : 100 * (k + 1), np.newaxis] / SCALE).astype(np.int16)
        ended_ns = due_ns + round(1e11 / rate_hz) + late_ns
        account.heard(Block(100 * k, codes, clock_ns=ended_ns, adc_ns=due_ns if counted else 0), 100)
    account.flush()
    assert (account.lost_samples == 0) == counted
