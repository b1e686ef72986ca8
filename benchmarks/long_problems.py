"""Long problems that benchmarks share: what is drawn, solved, judged and timed in turns with something else."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from turns import time_in_turns

from cpgrl_opt import SOLVERS, DirectionProblem, Status, kkt_residuals

SOLVER = SOLVERS["active-set"]
ANGLE = 1e-5  # rad


@dataclass(frozen=True)
class Answer:
    """What a work returned: the rung that answered, its error, and whether it failed."""

    rung: str
    error: float
    failed: bool


@dataclass(frozen=True)
class Data:
    """g and J as rows of A; bounds of a direction; average rewards, all below 0, of a step."""

    gradients: np.ndarray
    bound: np.ndarray
    values: np.ndarray

    @property
    def g(self) -> np.ndarray:
        """Row 0."""
        return self.gradients[0]

    @property
    def J(self) -> np.ndarray:
        """The other rows."""
        return self.gradients[1:]


def draw(n: int, m: int) -> Data:
    """Standard normal rows; bounds of a tenth of their length, which half of them exceed."""
    rng = np.random.default_rng([n, m])
    A = np.empty((1 + m, n))
    for row in A:
        rng.standard_normal(out=row)
    return Data(A, 0.1 * math.sqrt(n) * rng.standard_normal(m), -rng.uniform(0.5, 1.0, 1 + m))


def oppose(A: np.ndarray) -> None:
    """The last row ← minus the one before it, turned by `ANGLE` towards what it was; by blocks, without a copy."""
    for start in range(0, A.shape[1], 10_000):
        block = A[:, start : start + 10_000]
        block[-1] = ANGLE * block[-1] - block[-2]


def direction(g: Any, J: Any, bound: np.ndarray | float) -> tuple[Any, Any]:
    """Construction, solve and certificate."""
    problem = DirectionProblem(g, J, bound)
    return problem, SOLVER.solve(problem)


def judge(problem: DirectionProblem, found: Any) -> Answer:
    """By the residuals measured anew."""
    return Answer(found.rung, kkt_residuals(problem, found).worst, found.status != Status.OPTIMAL)


def time_beside(other: Callable[[], Any], run: Callable[[], Any], repeats: int) -> tuple[float, float, Any, Any]:
    """Median CPU seconds of each, and what each returned last."""
    seconds, results = time_in_turns({"other": other, "run": run}, repeats)
    return *(float(np.median(times)) for times in seconds.values()), *results.values()  # type: ignore[return-value]


def repeats_of(n: int, m: int, scale: float) -> int:
    """Fewer of what takes long: 25 down to 3, times the scale."""
    return max(1, round(scale * max(3, min(25, 300_000_000 // (n * (1 + m))))))
