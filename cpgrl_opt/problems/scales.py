"""Rows and gradients in other units, where absolute tolerances call anything solved, or nothing."""

import numpy as np

from ..problem import DirectionProblem
from .assembly import meet, rescale
from .case import Case
from .regular import M, N, ordinary
from .source import Source


def row_scales(source: Source, case: Case, *, decades: float | tuple[float, ...] = (6.0, 12.0)) -> DirectionProblem:
    """Rows times 10^−decades, 1, 10^decades, in any order: the direction stays."""
    n, m = source.shape(N, M)
    size = source.choice(decades) if isinstance(decades, tuple) else decades
    scales = 10.0 ** (size * (source.order(m) % 3 - 1.0))
    return meet(source, source.numbers(m, n) * scales[:, None], case)


def gradient_scale(
    source: Source, case: Case, *, scale: float | tuple[float, ...] = (1e-8, 1e-4, 1e8)
) -> DirectionProblem:
    """(c g, c J, c² b): the direction is c times as long."""
    c = source.choice(scale) if isinstance(scale, tuple) else scale
    return rescale(ordinary(source, case), float(np.float64(c)))
