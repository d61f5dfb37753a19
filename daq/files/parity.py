"""Parity over the sectors of a file, by which sectors that are known to be gone are computed from the others.

A Reed-Solomon code of erasures over GF(2^8) (Plank 1997, Softw. Pract. Exper. 27, 995), its matrix that of Cauchy
(Bloemer et al. 1995), of which every square part can be inverted. The file is cut into `DATA` stripes of equal length;
sector number s of all of them and of `SPARE` stripes of parity form a group, in which any `SPARE` may be gone. A hole
of a hundredth of the file touches one or two sectors of a group.
"""

from __future__ import annotations

import functools
import zlib
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

SECTOR = 512
DATA, SPARE = 100, 6
Bytes = NDArray[np.uint8]


@functools.cache
def _products() -> NDArray[np.uint8]:
    """Products in GF(2^8) with the polynomial 0x11d, ``(256, 256)``."""
    power, log = np.zeros(512, np.int64), np.zeros(256, np.int64)
    x = 1
    for k in range(255):
        power[k] = power[k + 255] = x
        log[x] = k
        x = x << 1 ^ (0x11D if x & 0x80 else 0)
    table: NDArray[np.uint8] = power[log[:, None] + log[None, :]].astype(np.uint8)
    table[0] = table[:, 0] = 0
    return table


@functools.cache
def _inverses() -> NDArray[np.uint8]:
    """Inverse of each element but 0."""
    inverses: NDArray[np.uint8] = np.argmax(_products() == 1, axis=1).astype(np.uint8)
    return inverses


@functools.cache
def _matrix() -> NDArray[np.uint8]:
    """Weight of each data stripe in each stripe of parity, ``(SPARE, DATA)``: Cauchy's 1 / (x + y)."""
    x, y = np.arange(SPARE)[:, None], SPARE + np.arange(DATA)[None, :]
    weights: NDArray[np.uint8] = _inverses()[x ^ y]
    return weights


def stripe_sectors(n_bytes: int) -> int:
    """Sectors in a stripe of a file of ``n_bytes``."""
    return -(-n_bytes // (DATA * SECTOR))


def sector_crcs(data: bytes | memoryview) -> NDArray[np.uint32]:
    """CRC-32 of each sector; the last may be short."""
    view, crc32 = memoryview(data), zlib.crc32
    return np.array([crc32(view[at : at + SECTOR]) for at in range(0, len(view), SECTOR)], np.uint32)


def parity_of(read: Callable[[int, int], bytes], n_bytes: int) -> tuple[Bytes, NDArray[np.uint32]]:
    """Stripes of parity of the first ``n_bytes`` of a file, and the CRC-32 of all its sectors.

    Shapes (SPARE, bytes of a stripe) and (sectors,).

    ``read`` gives the bytes from an offset on, so many of them.
    """
    length = stripe_sectors(n_bytes) * SECTOR
    parity, crcs = np.zeros((SPARE, length), np.uint8), [np.zeros(0, np.uint32)]
    products, matrix = _products(), _matrix()
    for j in range(DATA):
        data = read(j * length, max(0, min(length, n_bytes - j * length)))
        if not data:
            break
        crcs.append(sector_crcs(data))
        stripe = np.frombuffer(data, np.uint8)
        for i in range(SPARE):
            parity[i, : len(stripe)] ^= np.take(products[matrix[i, j]], stripe)
    return parity, np.concatenate(crcs)


def restored(
    read: Callable[[int, int], bytes], n_bytes: int, crcs: NDArray[np.uint32], parity: Mapping[int, Bytes]
) -> dict[int, bytes]:
    """Sectors that differ from their CRC-32 and can be computed, by number.

    ``parity`` holds its sound sectors by ``stripe * sectors in a stripe + number``; the rest is as of `parity_of`.
    """
    per_stripe, found = stripe_sectors(n_bytes), dict[int, bytes]()
    bad: dict[int, list[int]] = {}
    for k, crc in enumerate(crcs.tolist()):
        if zlib.crc32(read(k * SECTOR, min(SECTOR, n_bytes - k * SECTOR))) != crc:
            bad.setdefault(k % per_stripe, []).append(k // per_stripe)
    products, matrix = _products(), _matrix()
    for group, gone in bad.items():
        spare = [i for i in range(SPARE) if i * per_stripe + group in parity][: len(gone)]
        if len(spare) < len(gone):
            continue
        sums = np.stack([parity[i * per_stripe + group] for i in spare])
        for j in range(DATA):
            at = (j * per_stripe + group) * SECTOR
            if j not in gone and at < n_bytes:
                data = np.frombuffer(read(at, min(SECTOR, n_bytes - at)), np.uint8)
                for row, i in enumerate(spare):
                    sums[row, : len(data)] ^= np.take(products[matrix[i, j]], data)
        for j, data in zip(gone, _solved(matrix[np.ix_(spare, gone)], sums), strict=True):
            k = j * per_stripe + group
            sector = data[: min(SECTOR, n_bytes - k * SECTOR)].tobytes()
            if zlib.crc32(sector) == crcs[k]:
                found[k] = sector
    return found


def _solved(matrix: NDArray[np.uint8], sums: Bytes) -> Bytes:
    """Rows x of ``matrix x = sums`` in GF(2^8), by elimination; a part of Cauchy's matrix is never singular."""
    products, inverses = _products(), _inverses()
    a, b = matrix.copy(), sums.copy()
    for k in range(len(a)):
        pivot = k + int(np.flatnonzero(a[k:, k])[0])
        a[[k, pivot]], b[[k, pivot]] = a[[pivot, k]], b[[pivot, k]]
        scale = inverses[a[k, k]]
        a[k], b[k] = products[scale][a[k]], products[scale][b[k]]
        for other in range(len(a)):
            if other != k and a[other, k]:
                weight = a[other, k]
                a[other] ^= products[weight][a[k]]
                b[other] ^= products[weight][b[k]]
    return b
