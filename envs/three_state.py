"""The three-state task of §3 of the paper, where the best feasible policy is known exactly."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Float64
from .tabular import TabularMDP
from .tabular_env import TabularEnv
from .validation import number_between

# rⁱ(s_j, a_k) of §3.1: rows are states, columns actions. r² + r³ + r⁴ = 0 everywhere (docs/reproduction.md, slip
# 6).
REWARDS = (
    ((1, 0, -1), (1, 0, 2), (1, 0, -1)),
    ((0, -1, 0), (0, 0, 1), (0, 0, 0)),
    ((0, 0, 0), (0, 0, -1), (0, 0, 1)),
    ((0, 1, 0), (0, 0, 0), (0, 0, -1)),
)


@dataclass(frozen=True, init=False, eq=False)
class ThreeStateMDP(TabularMDP):
    """Action a_k in state s_j leads to s_{j+k}, indices mod 3, with probability 1 − slip; else to one of
    the other two, slip/2 each.

    So a₁ moves on by one, a₂ by two, a₃ stays. Under thresholds 0 the optimum is a₁ everywhere with average
    rewards [1, 0, 0, 0], for any slip in (0, 1): r¹ + r³ ≤ 1 in every state and action.
    Fig. 3's transitions are not in the text: docs/reproduction.md §2 says what was taken.

    Parameters
    ----------
    slip
        Probability.
    rewards
        (1 + m, 3, 3).
    start
        x₀; s₁, number 0, in the paper.
    """

    slip: float

    def __init__(self, slip: float = 0.2, rewards: ArrayLike = REWARDS, start: int = 0) -> None:
        object.__setattr__(self, "slip", number_between("slip", slip, 0.0, 1.0))
        super().__init__(_transitions(self.slip), rewards, start)


class ThreeStateEnv(TabularEnv):
    """`ThreeStateMDP` as a Gymnasium environment, `cpgrl/ThreeState-v0` (there cut off after 100 steps)."""

    def __init__(
        self, slip: float = 0.2, rewards: ArrayLike = REWARDS, start: int = 0, *, render_mode: str | None = None
    ) -> None:
        super().__init__(ThreeStateMDP(slip, rewards, start), render_mode=render_mode)


def _transitions(slip: float) -> Float64[np.ndarray, "3 3 3"]:
    transitions = np.full((3, 3, 3), slip / 2)
    state, action = np.indices((3, 3))
    transitions[state, action, (state + action + 1) % 3] = 1 - slip
    return transitions
