"""Formulations: (linearization, active set, restoration target) → direction problems.

With g = Δ¹, rows Δⁱ of J, t = −min(slack, 0) ≥ 0 and the active set 𝒜 (rows outside it are switched off by b = −∞):

    equality    s = argmin ½‖s − g‖²  s.t.  J s = 0      v = argmin ½‖v‖²  s.t.  J v = t     eq. 8–10 as printed, v = −d
    cone        s = argmin ½‖s − g‖²  s.t.  J s ≥ 0      v = argmin ½‖v‖²  s.t.  J v ≥ t     multipliers exact
    restoring   s = argmin ½‖s − g‖²  s.t.  J s ≥ (αₑ/α₁) t                                  one QP, restoration inside
    linearized  s = argmin ½‖s − g‖²  s.t.  J s ≥ (αₑ t − κ max(slack, 0))/α₁, all rows      slack kept, a part κ of it

A step then moves θ by α₁ s + αₑ v, and by α₁ s for `restoring` and `linearized`.
"""

from dataclasses import dataclass, replace

import numpy as np

from .arrays import Bool, Float, Int
from .problem import ProblemBatch

LARGE = 2.0**400  # rows between 1/LARGE and LARGE can be divided by their squared length without a thought


@dataclass(frozen=True, eq=False)
class ActiveConstraints:
    """B linearized problems before a formulation: Δ¹ and the rows of J, the target t ≥ 0, and the active set.

    exponents: rows were divided by 2 to these.
    """

    gradients: Float[np.ndarray, "B channels n"]
    target: Float[np.ndarray, "B m"]
    active: Bool[np.ndarray, "B m"]
    exponents: Int[np.ndarray, "B m"]

    def rows(self, chosen: np.ndarray, active: Bool[np.ndarray, "B m"] | None = None) -> "ActiveConstraints":
        """The same for the runs that a mask or an index array names; active: other sets, of all runs."""
        active = self.active if active is None else active
        return ActiveConstraints(self.gradients[chosen], self.target[chosen], active[chosen], self.exponents[chosen])

    def balance(self) -> "ActiveConstraints":
        """Rows beyond 2^±400 and their targets over a power of two that leaves the row's largest entry in ½ … 1.

        Nothing changes but these rows' multipliers t/‖Jᵢ‖², which leave float64 for rows beyond 1e±150.
        """
        largest = np.abs(self.gradients[:, 1:]).max(axis=2, initial=0.0)
        extreme = ~((largest > 1.0 / LARGE) & (largest < LARGE))
        if not (extreme & self.active).any():
            return self
        exponents = np.where(extreme, np.frexp(largest)[1], 0)
        gradients = self.gradients.copy()
        gradients[:, 1:] = np.ldexp(gradients[:, 1:], -exponents[:, :, None])
        return ActiveConstraints(gradients, np.ldexp(self.target, -exponents), self.active, exponents)

    def original(self, multipliers: Float[np.ndarray, "B m"]) -> Float[np.ndarray, "B m"]:
        """Multipliers of the rows as they were given; ±inf where they leave float64."""
        with np.errstate(over="ignore", under="ignore"):
            return np.asarray(np.ldexp(multipliers, -self.exponents))

    def soften(self, ridge: float) -> "ActiveConstraints":
        """Rows [J, √ε I] and gradient [g, 0]: J Jᵀ becomes J Jᵀ + εI in P and d, and everything else is unchanged."""
        runs, channels, _ = self.gradients.shape
        soft = np.sqrt(float(ridge)) * np.eye(channels, channels - 1, -1)
        return replace(self, gradients=np.concatenate([self.gradients, np.tile(soft, (runs, 1, 1))], axis=2))


@dataclass(frozen=True)
class Formulation:
    """Which problems a step solves: is the active set held with equality, and is the restoration inside the QP?

    takes_all: all constraints are in it, those that are met with a part of their slack.
    """

    is_equality: bool
    restores_inside: bool
    takes_all: bool = False

    def tangents(self, constraints: ActiveConstraints, rate_ratio: float = 0.0) -> ProblemBatch:
        """The B tangent problems alone."""
        return self.problems(constraints, rate_ratio)[: len(constraints.target)]

    def problems(self, constraints: ActiveConstraints, rate_ratio: float) -> ProblemBatch:
        """B tangent problems, followed by B restoration problems unless these are inside; rate_ratio is αₑ/α₁."""
        runs, _, n = constraints.gradients.shape
        inside, kinds = (rate_ratio, 1) if self.restores_inside else (0.0, 2)
        gradient, active = np.zeros((kinds * runs, n)), np.concatenate([constraints.active] * kinds)
        gradient[:runs] = constraints.gradients[:, 0]
        with np.errstate(over="ignore", invalid="ignore"):
            asked = np.concatenate([inside * constraints.target, constraints.target][:kinds])
        bound = np.where(active, asked, -np.inf)
        if not (bound < np.inf).all():
            raise ValueError("slack, times restoration_rate / step_size, should be finite; found one that overflows")
        jacobian = np.concatenate([constraints.gradients[:, 1:]] * kinds)
        return ProblemBatch.trusted(gradient, jacobian, bound, active & self.is_equality)


FORMULATIONS = {
    "equality": Formulation(is_equality=True, restores_inside=False),
    "cone": Formulation(is_equality=False, restores_inside=False),
    "restoring": Formulation(is_equality=False, restores_inside=True),
    "linearized": Formulation(is_equality=False, restores_inside=True, takes_all=True),
}
