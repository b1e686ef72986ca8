"""The random stream inside compiled kernels: xoshiro256++ on four words of state.

Part of the interface: whoever draws within a kernel advances the same array, `interface.random_state`, by
these. Unlike the rest of the interface this module imports numba; only modules that hold kernels import it.
numba's cache of a caller does not notice a change made here: that of envs is cleared below, rl's by rl.
Source: Blackman & Vigna (2021), Scrambled linear pseudorandom number generators, ACM TOMS 47(4).
"""

from pathlib import Path

import numba
import numpy as np

from .kernel_cache import forget_outdated_kernels

_HERE = Path(__file__).parent
_FOLDERS = [_HERE, _HERE.parent]
_SOURCES = [source for folder in _FOLDERS for source in folder.glob("*.py")]
forget_outdated_kernels(_FOLDERS, _SOURCES)  # before any kernel is loaded: all import this module


@numba.njit  # type: ignore[misc, unused-ignore]
def _rotate(word, bits):  # type: ignore[no-untyped-def]
    return (word << np.uint64(bits)) | (word >> np.uint64(64 - bits))


@numba.njit  # type: ignore[misc, unused-ignore]
def next_word(random_state):  # type: ignore[no-untyped-def]
    """64 uniform bits; advances the four words of `random_state` in place."""
    s0, s1, s2, s3 = random_state[0], random_state[1], random_state[2], random_state[3]
    word = _rotate(s0 + s3, 23) + s0
    s2 ^= s0
    s3 ^= s1
    random_state[0] = s0 ^ s3
    random_state[1] = s1 ^ s2
    random_state[2] = s2 ^ (s1 << np.uint64(17))
    random_state[3] = _rotate(s3, 45)
    return word


@numba.njit  # type: ignore[misc, unused-ignore]
def uniform(random_state):  # type: ignore[no-untyped-def]
    """k/2⁵³, k uniform on 0 … 2⁵³ − 1: a number in [0, 1)."""
    return np.float64(next_word(random_state) >> np.uint64(11)) * 2.0**-53
