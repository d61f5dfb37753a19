"""Parity over the sectors of a file: what is gone is computed from the rest."""

from __future__ import annotations

import numpy as np
import pytest

from daq.files.parity import SECTOR, SPARE, parity_of, restored, stripe_sectors


def damaged(n_bytes: int, gone: list[int], gone_parity: list[int]) -> tuple[bytes, bytearray, dict[int, bytes]]:
    """Random bytes, the same with sectors zeroed, and those sectors as they are computed."""
    sound = np.random.default_rng(n_bytes).bytes(n_bytes)
    parity, crcs = parity_of(lambda at, n: sound[at : at + n], n_bytes)
    cut = bytearray(sound)
    for k in gone:
        cut[k * SECTOR : (k + 1) * SECTOR] = bytes(len(cut[k * SECTOR : (k + 1) * SECTOR]))
    per_stripe = stripe_sectors(n_bytes)
    held = {
        i * per_stripe + k: parity[i, k * SECTOR : (k + 1) * SECTOR]
        for i in range(SPARE) for k in range(per_stripe) if i * per_stripe + k not in gone_parity
    }  # fmt: skip
    return sound, cut, restored(lambda at, n: bytes(cut[at : at + n]), n_bytes, crcs, held)


@pytest.mark.parametrize("n_bytes", [1, 511, 512, 51_200, 123_457])
def test_a_hole_of_two_hundredths_anywhere_is_filled(n_bytes: int) -> None:
    """Whatever the length, a run of sectors as long as two stripes comes back byte for byte."""
    n_sectors, long = -(-n_bytes // SECTOR), 2 * stripe_sectors(n_bytes)
    for first in range(0, n_sectors, max(1, n_sectors // 7)):
        gone = list(range(first, min(first + long, n_sectors)))
        sound, cut, found = damaged(n_bytes, gone, [])
        assert sorted(found) == gone
        for k, sector in found.items():
            cut[k * SECTOR : k * SECTOR + len(sector)] = sector
        assert bytes(cut) == sound


def test_as_many_as_there_are_stripes_of_parity_may_be_gone() -> None:
    """Of one group, any six may be gone, parity among them; of seven none comes back, and nothing is made up."""
    per_stripe = stripe_sectors(200_000)
    group = [j * per_stripe + 1 for j in (0, 7, 31, 32, 48)]
    assert sorted(damaged(200_000, group, [1 * per_stripe + 1])[2]) == group
    assert damaged(200_000, group, [1 * per_stripe + 1, 4 * per_stripe + 1])[2] == {}
