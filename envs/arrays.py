"""Shape types of finite Markov decision processes.

`channels` counts rewards, the intrinsic one first: 1 + m. `*runs` are leading axes, one entry for each of
many policies that are asked about at once.
"""

import numpy as np
from jaxtyping import Float64

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
