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
from .step_kernels import fill_problems

_LARGEST_EXPONENT = 400  # as `step_kernels.admit` has it


@dataclass(frozen=True, eq=False)
class ActiveConstraints:
    """B linearized problems before a formulation: Δ¹ and the rows of J, the target t ≥ 0, and the active set.

    exponents: rows were divided by 2 to these, None where none was. room: what of its slack a constraint may lose, None
    where none may lose any.
    """

    gradients: Float[np.ndarray, "B channels n"]
    target: Float[np.ndarray, "B m"]
    active: Bool[np.ndarray, "B m"]
    exponents: Int[np.ndarray, "B m"] | None = None
    room: Float[np.ndarray, "B m"] | None = None

    @property
    def jacobian(self) -> Float[np.ndarray, "B m n"]:
        """J, of every constraint."""
        return self.gradients[:, 1:]

    def rows(self, chosen: np.ndarray, active: Bool[np.ndarray, "B m"] | None = None) -> "ActiveConstraints":
        """The same for the runs that a mask or an index array names; active: other sets, of all runs."""
        exponents = None if self.exponents is None else self.exponents[chosen]
        room = None if self.room is None else self.room[chosen]
        active = self.active if active is None else active
        return ActiveConstraints(self.gradients[chosen], self.target[chosen], active[chosen], exponents, room)

    def balanced(self) -> "ActiveConstraints":
        """Rows beyond 2^±400 and their targets over a power of two that leaves the row's largest entry in ½ … 1.

        Nothing changes but these rows' multipliers t/‖Jᵢ‖², which leave float64 for rows beyond 1e±150.
        """
        jacobian = self.jacobian
        _, exponents = np.frexp(np.abs(jacobian).max(axis=2, initial=0.0))
        exponents = np.where(np.abs(exponents) < _LARGEST_EXPONENT, 0, exponents)
        gradients = self.gradients.copy()
        gradients[:, 1:] = np.ldexp(jacobian, -exponents[:, :, None])
        room = None if self.room is None else np.ldexp(self.room, -exponents)
        target = np.ldexp(self.target, -exponents)
        return replace(self, gradients=gradients, target=target, exponents=exponents, room=room)

    def original(self, multipliers: Float[np.ndarray, "B m"]) -> Float[np.ndarray, "B m"]:
        """Multipliers of the rows as they were given; ±inf where they leave float64."""
        if self.exponents is None:
            return multipliers
        with np.errstate(over="ignore", under="ignore"):
            return np.asarray(np.ldexp(multipliers, -self.exponents))

    def violated(self) -> "ActiveConstraints":
        """The same with only those active that are violated."""
        return replace(self, active=self.active & (self.target > 0.0))

    def demands(self, rate: float) -> "ActiveConstraints":
        """αₑ t − room in the place of t."""
        return self if self.room is None else replace(self, target=rate * self.target - self.room, room=None)

    def softened(self, ridge: float) -> "ActiveConstraints":
        """Rows [J, √ε I] and gradient [g, 0]: J Jᵀ becomes J Jᵀ + εI in P and d, and everything else is unchanged."""
        runs, channels, n = self.gradients.shape
        m = channels - 1
        gradients = np.zeros((runs, channels, n + m))
        gradients[:, :, :n] = self.gradients
        gradients[:, range(1, channels), range(n, n + m)] = np.sqrt(ridge)
        return replace(self, gradients=gradients)


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
        runs, channels, n = constraints.gradients.shape
        count, m = runs if self.restores_inside else 2 * runs, channels - 1
        g, J, b, is_equality = (
            np.empty((count, n)), np.empty((count, m, n)), np.empty((count, m)), np.empty((count, m), np.bool_)
        )  # fmt: skip
        is_finite = fill_problems(
            constraints.gradients,
            constraints.target,
            constraints.active,
            self.is_equality,
            rate_ratio if self.restores_inside else 0.0,
            g,
            J,
            b,
            is_equality,
        )
        if not is_finite:
            raise ValueError(
                "slack, times restoration_rate / step_size where the restoration is inside, should be finite in units "
                "of its constraint's gradient; found one that overflows"
            )
        return ProblemBatch.trusted(g, J, b, is_equality)


FORMULATIONS = {
    "equality": Formulation(is_equality=True, restores_inside=False),
    "cone": Formulation(is_equality=False, restores_inside=False),
    "restoring": Formulation(is_equality=False, restores_inside=True),
    "linearized": Formulation(is_equality=False, restores_inside=True, takes_all=True),
}


def least_norm_restorations(constraints: ActiveConstraints, formulation: str = "equality") -> ProblemBatch:
    """v = J⁺ t on the active rows: argmin ½‖v‖² s.t. J v = t; J v ≥ t for "cone". Source: eq. 10, v = −d."""
    return FORMULATIONS[formulation].problems(constraints, 0.0)[len(constraints.target) :]
