"""The default solver: the exact core, compiled.

    min ½‖d − g‖²   s.t.   Jᵢd ≥ bᵢ (i ∈ I),   Jᵢd = bᵢ (i ∈ E)

A direct pass by the Gram matrix where rows are well apart; else Goldfarb and Idnani's method on orthonormal rows. Both
judge their answers with the referee's formulas; `thorough` proves infeasibility.
"""

from dataclasses import dataclass
from typing import ClassVar

from .base import ExactSolver


@dataclass(frozen=True, kw_only=True)
class ActiveSet(ExactSolver):
    """Goldfarb & Idnani's dual method in the basis of the active rows. The default.

    tolerance: the worst KKT residual of an OPTIMAL answer; the method reaches 1e-12 wherever float64 allows it.
    """

    tolerance: float = 1e-9

    package: ClassVar[str] = "numba"
    source: ClassVar[str] = "Goldfarb & Idnani 1983"
    guarantee: ClassVar[str] = "exact: dual active set on orthonormal rows; compiled, batched"
