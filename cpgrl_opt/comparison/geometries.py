"""How the families with a metric or a ball make their problems: Gaussian ones, measured otherwise.

Balls are as long as it takes: their radius is a multiple of the length of a direction that meets the constraints, or a
part of the length of the shortest that does, which is known exactly.
"""

import math
from collections.abc import Callable

import numpy as np

from ..metric import Metric
from ..problem import DirectionProblem
from . import generators as draw
from .exact_trust_region import shortest_length

_REACHES = 1.5  # times the shortest: the ball meets the constraints, and holds most of what climbs back
_MISSES = 0.5


def diagonal_metric(rng: np.random.Generator, n: int = draw.N) -> Metric:
    """Weights from 10⁻² to 10²."""
    return np.asarray(10.0 ** rng.uniform(-2, 2, n))


def full_metric(rng: np.random.Generator, n: int = draw.N, *, decades: int = 2) -> Metric:
    """Q diag(1 … 10^decades) Qᵀ, Q turned at random."""
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    M = (Q * np.logspace(0, decades, n)) @ Q.T
    return np.asarray(0.5 * (M + M.T))


def in_metric(rng: np.random.Generator, metric: Callable[[np.random.Generator], Metric]) -> DirectionProblem:
    """Three Gaussian rows with bounds that some direction meets, in a metric."""
    return _measured(draw.well_conditioned(rng, bounds=True), metric(rng))


def in_ball(
    rng: np.random.Generator,
    metric: Callable[[np.random.Generator], Metric] | None = None,
    *,
    bounds: bool = True,
    factor: float = _REACHES,
) -> DirectionProblem:
    """Three Gaussian rows, in a ball of `factor` times what the shortest direction needs; of any size for b = 0."""
    while True:
        base = _measured(draw.well_conditioned(rng, bounds=bounds), None if metric is None else metric(rng))
        shortest = shortest_length(base)
        if not bounds:
            return _measured(base, base.metric, float(10.0 ** rng.uniform(-3, 3)))
        if shortest:
            return _measured(base, base.metric, factor * shortest)


def out_of_reach(rng: np.random.Generator) -> DirectionProblem:
    """The ball is half of what the shortest direction needs, in a diagonal metric."""
    return in_ball(rng, diagonal_metric, factor=_MISSES)


def impossible_in_huge_ball(rng: np.random.Generator, radius: float) -> DirectionProblem:
    """Four rows that contradict each other; the radius is somebody's word for "none"."""
    return _measured(draw.infeasible(rng, support=4, gap=0.3), None, radius * math.exp(rng.uniform(-1, 1)))


def _measured(problem: DirectionProblem, metric: Metric | None, radius: float | None = None) -> DirectionProblem:
    return DirectionProblem(problem.gradient, problem.jacobian, problem.bound, problem.equality, metric, radius)
