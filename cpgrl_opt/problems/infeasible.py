"""Problems without an answer, from a Farkas vector: y ≥ 0 on I, Jᵀy = 0, bᵀy > 0, so that no d has Jd ≥ b."""

from collections.abc import Sequence

import numpy as np

from ..problem import DirectionProblem
from .assembly import vary
from .case import Case
from .dependent import positively_dependent
from .regular import N, ordinary
from .source import Source


def infeasible(
    source: Source,
    case: Case,
    *,
    support: int | tuple[int, ...] = (2, 3, 2, 1, 6, 12),
    gap: float | tuple[float, ...] = (1.0, 1 / 32),
    equality: Sequence[bool] | None = None,
) -> DirectionProblem:
    """Σ yᵢJᵢ = 0 over `support` rows, y > 0, and bᵢ = Jᵢd₀ + gap·‖g‖·‖Jᵢ‖ on these: no d gives them all.

    One row alone is a zero row. The other rows spare something at d₀. equality: of the support and one more row; else
    as the case has it.
    """
    most = source.choice(support) if isinstance(support, tuple) else support
    n, m = source.shape(N, most + 1)
    k = min(most, m, n + 1)
    J, _ = positively_dependent(source, source.exact(k - 1, n))
    J = np.vstack([J, source.numbers(m - k, n)])
    point, g = source.point(n), source.numbers(n)
    part = source.choice(gap) if isinstance(gap, tuple) else gap
    ask = np.append(np.full(k, part), -source.uniform(0.1, 1.0, m - k)) * float(source.size(g)) * source.size(J)
    is_equality = source.equalities(m, case) if equality is None else np.array(equality)
    order = source.order(m)
    return DirectionProblem(g, J[order], (J @ point + ask)[order], is_equality[order])


def zero_row_asks(source: Source, case: Case, *, decades: tuple[float, float] = (-6.0, 1.0)) -> DirectionProblem:
    """0ᵀd ≥ b > 0, or = b, for one of the rows; b between 10^decades."""
    base = ordinary(source, case, m=4)
    J, b, row = base.jacobian.copy(), base.bound.copy(), int(source.integers(0, base.m - 1))
    J[row], b[row] = 0.0, 10.0 ** source.uniform(*decades)
    return vary(base, jacobian=J, bound=b)
