"""Steps, linearizations and solvers for the tests of steps."""

from dataclasses import dataclass

import numpy as np

from cpgrl_opt import ConstrainedStep, Direction, Linearization, Status

FORMULATIONS = ["equality", "cone", "restoring", "linearized"]
ACTIVE_ONLY = FORMULATIONS[:3]
KINDS = ["generic", "sum", "opposed", "integers", "flat"]


def plain(**settings):
    """The paper's rates; no constraint is dropped."""
    return ConstrainedStep(**{"step_size": 0.02, "restoration_rate": 0.05, "drop": "never", **settings})


def full(**settings):
    """κ = α₁ = αₑ = 1."""
    rates = {"step_size": 1.0, "restoration_rate": 1.0, "formulation": "linearized"}
    return ConstrainedStep(**{**rates, **settings})


def drawn(seed, m=3, n=3, kind="generic", *, runs=(), size=1.0):
    """Rows apart, summing to 0, two that oppose each other, one that is 0, or small integers with Δ¹ in their span.

    Also: Δ¹ against the sum of rows that are apart, or along it, and two rows 1e-6 rad or so from opposing.

    Slacks beside thresholds of 0 are about `size` and of either sign, but negative for integers.
    """
    rng = np.random.default_rng(seed)
    V = rng.standard_normal((*runs, 1 + m, n))
    if kind == "sum":
        V[..., -1, :] = -V[..., 1:-1, :].sum(axis=-2)
    if kind == "opposed":
        V[..., 2, :] = -rng.uniform(0.5, 2.0) * V[..., 1, :]
    if kind == "integers":
        V = rng.integers(-2, 3, size=V.shape).astype(float)
        V[..., :1, :] = rng.integers(-2, 3, size=(*runs, 1, m)) @ V[..., 1:, :]
    if kind == "flat":
        V[..., 1, :] = 0.0
    if kind in ("stationary", "in the span"):
        V[..., 0, :] = (-1.0 if kind == "stationary" else 1.0) * V[..., 1:, :].sum(axis=-2)
    if kind == "nearly opposing":
        V[..., -1, :] = -V[..., 1, :] + 1e-6 * V[..., -1, :]
    values = size * rng.standard_normal((*runs, 1 + m))
    values = -np.abs(values) if kind == "integers" else values
    values[..., 0] = 0.0
    return Linearization(values, V)


def require_same(one, other, *, atol=0.0):
    """The same change and everything that is said of it, bit for bit where atol is 0; changes but for atol."""
    np.testing.assert_allclose(one.change, other.change, rtol=0.0, atol=atol)
    names = (
        ("active", "stationary") if atol else ("active", "stationary", "multipliers", "residuals", "predicted_slack")
    )
    for name in names:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    for name, count in other.counts.items():
        np.testing.assert_array_equal(one.counts[name], count, err_msg=name)


@dataclass(frozen=True)
class Claiming:
    """A third party's solver that says the same of every problem: a value, or g, a status, and each multiplier."""

    value: float | None
    status: Status
    multiplier: float = 0.0
    tolerance: float = 1e-9

    def solve(self, problem):
        value = problem.gradient if self.value is None else np.full(problem.n, self.value)
        return Direction(value, np.full(problem.m, self.multiplier), self.status)
