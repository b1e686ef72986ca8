"""Shape types of finite Markov decision processes.

`channels` counts rewards, the intrinsic one first: 1 + m. `*runs` are leading axes, one entry for each of
many policies that are asked about at once. jaxtyping checks shapes in the tests, whose import hook loads it
before this package; otherwise they stand for any array, since it takes 50 ms to import.
"""

import sys
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool as Bool
    from jaxtyping import Float64 as Float64
    from jaxtyping import Int64 as Int64
    from jaxtyping import UInt8 as UInt8
    from jaxtyping import UInt64 as UInt64
else:

    class _Array:
        """`Float64[np.ndarray, "m n"]` is np.ndarray."""

        def __class_getitem__(cls, array_and_shape):
            return array_and_shape[0]

    Bool = Float64 = Int64 = UInt8 = UInt64 = _Array

Transitions = Float64[np.ndarray, "states actions states"]
Rewards = Float64[np.ndarray, "channels states actions"]
PolicyTable = Float64[np.ndarray, "*runs states actions"]
Chain = Float64[np.ndarray, "*runs states states"]
StateDistribution = Float64[np.ndarray, "*runs states"]
ChannelValues = Float64[np.ndarray, "channels"]
Thresholds = Float64[np.ndarray, "m"]
Occupancy = Float64[np.ndarray, "states actions"]
AverageRewards = Float64[np.ndarray, "*runs channels"]
TableGradients = Float64[np.ndarray, "*runs channels states actions"]
