"""Numbers of bfloat16, of which NumPy knows nothing: 16 bits, the upper half of those of a float32.

Each function takes numbers or arrays, and can be compiled.
"""

from typing import Any

import numpy as np


def widen(bits: Any) -> Any:
    """The float32 that the bits stand for."""
    return np.uint32(np.uint32(bits) << 16).view(np.float32)


def narrow(number: Any) -> Any:
    """The bits of the bfloat16 nearest to a float64, of two the even one.

    By way of the float32 next to it whose last bit is 1, unless it is exact: it is never half way between two bfloat16
    where the number itself is not.
    """
    single = np.float32(number)
    bits = single.view(np.int32)
    outward = 1 - 2 * (np.abs(single) > np.abs(number))
    odd = bits + outward * ((single != number) & (bits & 1 == 0))
    return np.uint16((odd + 0x7FFF + (odd >> 16 & 1)) >> 16 & 0xFFFF)
