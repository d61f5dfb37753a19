"""Random numbers inside the compiled plant: SplitMix64 words of a counter, from keys drawn off the passed generator.

A number depends on its key and counter only, so blocks of any size see the same chance.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from kernels import njit

_GOLDEN, _MIX_1, _MIX_2 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_HALF_WORD = np.uint64(0xFFFF)
_FOUR_UNIFORMS_MEAN, _FOUR_UNIFORMS_SD = 131070.0, 37837.2


@njit()
def _word(counter: Any) -> Any:
    """64 well mixed bits (Steele, Lea and Flood 2014, SplitMix64)."""
    z = counter * _GOLDEN
    z = (z ^ (z >> np.uint64(30))) * _MIX_1
    z = (z ^ (z >> np.uint64(27))) * _MIX_2
    return z ^ (z >> np.uint64(31))


@njit()
def small_noise(counter: Any) -> float:
    """Noise of unit variance, the sum of four uniforms: for channels whose noise is a few codes."""
    z = _word(counter)
    total = (z & _HALF_WORD) + ((z >> np.uint64(16)) & _HALF_WORD) + ((z >> np.uint64(32)) & _HALF_WORD)
    return (float(total + (z >> np.uint64(48))) - _FOUR_UNIFORMS_MEAN) / _FOUR_UNIFORMS_SD


@njit()
def uniform(s: Any) -> float:
    """The next number in [0, 1) of the plant's events (contact bounce, scattered rebounds)."""
    s.event_counter += np.uint64(1)
    return float(_word(s.event_counter) >> np.uint64(11)) * 2.0**-53
