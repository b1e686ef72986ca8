"""Formulations: (linearization, active set, restoration target) → direction problems.

With g = Δ¹, rows Δⁱ of J, t = −min(slack, 0) ≥ 0 and the active set 𝒜 (rows outside it are switched off by b = −∞):

    equality    s = argmin ½‖s − g‖²  s.t.  J s = 0      v = argmin ½‖v‖²  s.t.  J v = t     eq. 8–10 as printed, v = −d
    cone        s = argmin ½‖s − g‖²  s.t.  J s ≥ 0      v = argmin ½‖v‖²  s.t.  J v ≥ t     multipliers exact
    restoring   s = argmin ½‖s − g‖²  s.t.  J s ≥ (αₑ/α₁) t                                  one QP, restoration inside

A step then moves θ by α₁ s + αₑ v, and by α₁ s for `restoring`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from .problem import ProblemBatch


@dataclass(frozen=True, eq=False)
class ActiveConstraints:
    """B linearized problems before a formulation: g (B, n), J (B, m, n), target t (B, m) ≥ 0, active (B, m)."""

    gradient: Float[np.ndarray, "B n"]
    jacobian: Float[np.ndarray, "B m n"]
    target: Float[np.ndarray, "B m"]
    active: Bool[np.ndarray, "B m"]

    def rows(self, chosen: Bool[np.ndarray, "B"]) -> "ActiveConstraints":
        """The same for some of the runs."""
        return ActiveConstraints(self.gradient[chosen], self.jacobian[chosen], self.target[chosen], self.active[chosen])

    def softened(self, ridge: float) -> "ActiveConstraints":
        """Rows [J, √ε I] and gradient [g, 0]: J Jᵀ becomes J Jᵀ + εI in P and d, and everything else is unchanged."""
        runs, m, n = self.jacobian.shape
        jacobian = np.zeros((runs, m, n + m))
        jacobian[:, :, :n] = self.jacobian
        jacobian[:, range(m), range(n, n + m)] = np.sqrt(ridge)
        gradient = np.zeros((runs, n + m))
        gradient[:, :n] = self.gradient
        return ActiveConstraints(gradient, jacobian, self.target, self.active)


# (constraints, αₑ/α₁) → B tangent problems, followed by B restoration problems where the formulation has any
Formulation = Callable[[ActiveConstraints, float], ProblemBatch]


def equality(constraints: ActiveConstraints, rate_ratio: float) -> ProblemBatch:  # noqa: ARG001 - one signature
    """Tangent and least-norm restoration with J s = 0, J v = t. Source: eq. 8–10."""
    return _tangent_and_restoration(constraints, constraints.active)


def cone(constraints: ActiveConstraints, rate_ratio: float) -> ProblemBatch:  # noqa: ARG001 - one signature
    """Tangent and least-norm restoration with J s ≥ 0, J v ≥ t."""
    return _tangent_and_restoration(constraints, np.zeros_like(constraints.active))


def restoring(constraints: ActiveConstraints, rate_ratio: float) -> ProblemBatch:
    """One QP, J s ≥ (αₑ/α₁) t."""
    bound = np.where(constraints.active, rate_ratio * constraints.target, -np.inf)
    return ProblemBatch.trusted(constraints.gradient, constraints.jacobian, bound, np.zeros_like(constraints.active))


FORMULATIONS: dict[str, Formulation] = {"equality": equality, "cone": cone, "restoring": restoring}


def least_norm_restoration(constraints: ActiveConstraints) -> ProblemBatch:
    """v = J⁺ t on the active rows: argmin ½‖v‖² s.t. J v = t. Source: eq. 10, v = −d."""
    bound = np.where(constraints.active, constraints.target, -np.inf)
    return ProblemBatch.trusted(np.zeros_like(constraints.gradient), constraints.jacobian, bound, constraints.active)


def _tangent_and_restoration(constraints: ActiveConstraints, equality: Bool[np.ndarray, "B m"]) -> ProblemBatch:
    runs, m, n = constraints.jacobian.shape
    gradient = np.zeros((2 * runs, n))
    gradient[:runs] = constraints.gradient
    jacobian = np.empty((2, runs, m, n))
    jacobian[:] = constraints.jacobian
    bound = np.full((2, runs, m), -np.inf)
    np.copyto(bound[0], 0.0, where=constraints.active)
    np.copyto(bound[1], constraints.target, where=constraints.active)
    both = np.concatenate((equality, equality))
    return ProblemBatch.trusted(gradient, jacobian.reshape(2 * runs, m, n), bound.reshape(2 * runs, m), both)
