"""What is asked of a step: numbers that `jit` can compile for; ValueError for what neither path can do."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from ..active_set import violated
from ..formulation import FORMULATIONS
from ..solvers import ActiveSet, tolerance_of
from ..step import ConstrainedStep
from ..validation import require_member

PATHS = ("device", "host")
KINDS = ("cost", "reward")
DEVICE_FORMULATIONS = ("restoring", "linearized")


class Settings(NamedTuple):
    """A step's, hashable. restored αₑ/α₁, kept κ/α₁ (None where constraints with slack are left out).

    signs: of channel 0 and of the constraints, as they are given: −1 of what is to fall.
    """

    step: ConstrainedStep
    path: str
    signs: tuple[float, float]
    restored: float
    kept: float | None
    tolerance: float

    @property
    def is_one_problem(self) -> bool:
        """Whether d = g + Jᵀμ is all of the step."""
        return self.step.formulation in DEVICE_FORMULATIONS

    def bound(self, slack: Any) -> Any:
        """b of J d ≥ b, −∞ where a constraint is left out."""
        below, above = self.restored * jnp.maximum(-slack, 0.0), jnp.maximum(slack, 0.0)
        return jnp.where(slack <= 0.0, below, -jnp.inf) if self.kept is None else below - self.kept * above

    def bound_rate(self, slack: Any) -> Any:
        """db/dslack, where b is finite; at slack = 0 that of a constraint which is violated."""
        return jnp.where(slack > 0.0, -(self.kept or 0.0), -self.restored)


def read_step(step: Any, path: str, kind: str, objective: float) -> Settings:
    """ValueError for a step that this path cannot take. objective: the sign of channel 0."""
    require_member("kind", kind, KINDS)
    if not isinstance(step, ConstrainedStep):
        raise ValueError(f"step should be a ConstrainedStep; found {step!r}")
    require_member("path", path, PATHS)
    of, rate = FORMULATIONS[step.formulation], float(step.step_size)  # type: ignore[arg-type]
    if rate == 0.0:
        raise ValueError("step_size of step should be > 0, which the gradient is in units of; found 0")
    if step.rule is not violated:
        raise ValueError(f"rule of step should be the default, since others may not be traced; found {step.rule!r}")
    if step.metric is not None:
        raise ValueError("metric of step should be None, since JAX knows parameters as a tree; found one")
    if step.on_failure == "raise":
        raise ValueError("on_failure of step should not be 'raise', since nothing can be raised under jit; found it")
    if path == "device":
        _require_device(step)
    kept = float(step.slack_fraction) / rate if of.takes_all else None
    signs = objective, -1.0 if kind == "cost" else 1.0
    return Settings(step, path, signs, float(step.restoration_rate) / rate, kept, tolerance_of(step.solver))


def _require_device(step: ConstrainedStep) -> None:
    host = "on the device (path='host' takes all)"
    require_member(f"formulation of step {host}", step.formulation, DEVICE_FORMULATIONS)
    if type(step.solver) is not ActiveSet:
        raise ValueError(f"solver of step should be active-set {host}; found {step.solver!r}")
    for name, plain in (("radius", None), ("ridge", 0), ("max_restoration", float("inf"))):
        if (found := getattr(step, name)) != plain:
            raise ValueError(f"{name} of step should be {plain} {host}; found {found!r}")
