"""One step of a constrained learner: rule → formulation → solver → safeguards → parameter change.

θ ← θ + α₁ s + αₑ v        (eq. 8 of the paper, v = −d)
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from ._step_run import CLOSED_FORM, COUNTS, StepRun, nothing
from .active_set import ACTIVE_SET_RULES, ActiveSetRule, violated
from .arrays import ArrayLike, Bool, Float, Int, Number
from .direction import DirectionBatch
from .drop_rule import NEGLIGIBLE
from .formulation import FORMULATIONS
from .linearization import Linearization
from .metric import Whitening, validated_metric
from .problem import ProblemBatch
from .solvers import (
    SOLVERS,
    DirectionSolver,
    Rosen,
    facts_of,
    solver_named,
    tolerance_of,
)
from .step_in_span import step_in_span
from .validation import (
    ReadOnlyArrays,
    boolean_array,
    finite_array,
    is_finite,
    read_only,
    real_values,
    require_member,
    require_nonnegative,
    require_positive,
    require_shape,
)
from .vectors import is_long

Observer = Callable[[ProblemBatch, DirectionBatch], None]

DROP_RULES = ("never", "stationary", "always")
ON_FAILURE = ("fallback", "skip", "raise")


@dataclass(frozen=True, eq=False)
class StepResult:
    """The parameter change and what happened on the way; leading axes as in the linearization.

    change: (…, n); active: (…, m), the set that the rule chose; stationary: (…), PΔ¹ = 0 and some λ ≤ 0 exists,
    both up to rounding: a KKT point.
    counts, by name (…): infeasible (subproblems, solved by least violation), fallback (handed to active-set),
    skipped (no certified direction: change 0), dropped (constraints), capped (restoration shortened), softened (by the
    ridge, where a constraint was active),
    flat (active constraints whose gradient is 0: to first order no direction changes them, so they are left out).
    """

    change: Float[np.ndarray, "*runs n"]
    active: Bool[np.ndarray, "*runs m"]
    stationary: Bool[np.ndarray, "*runs"]
    counts: Mapping[str, Int[np.ndarray, "*runs"]]


@dataclass(frozen=True, kw_only=True)
class ConstrainedStep(ReadOnlyArrays):
    """Settings of a step; calling it maps a linearization to a `StepResult`.

    solver, rule: objects, or the names of SOLVERS, ACTIVE_SET_RULES; formulation: a name of FORMULATIONS. What a
        solver that is not of SOLVERS calls OPTIMAL or INFEASIBLE is put before the referee here.
    step_size α₁ and restoration_rate αₑ: ≥ 0 (the paper: both 0.02), α₁ > 0 for `restoring`.
    drop: which constraints `equality` takes out of 𝒜 (§2.3): "stationary", argmax λᵢ‖Jᵢ‖ while PΔ¹ = 0 and no λ ≤ 0
        exists; "always", whether PΔ¹ = 0 or not; "never". λ is the step's own, of dependent rows the one of least norm,
        and what ties leaves together, so that neither the solver nor the order of the constraints decides: see
        `drop_rule`. raw_multipliers compares λᵢ instead, as printed.
    ridge ε ≥ 0: softens the constraints, (JJᵀ + εI)⁻¹ in P and d; in the squared unit of a gradient. Ours.
    max_restoration: restoration shortened to ‖αₑ J⁺ min(slack, 0)‖ ≤ max_restoration, in the unit of θ (in the
        metric's where there is one). Where rows depend, J⁺ answers by least squares and may be much shorter than the v
        of `cone`: then αₑ‖v‖ ≤ max_restoration too, in `cone` and in `restoring`, where that v is inside. Ours.
    metric M: (n,) positive or (n, n) symmetric positive definite: s, v and their lengths are taken in it (a natural
        gradient where M is the Fisher matrix). radius > 0: s climbs most in sᵀMs ≤ radius², instead of being Δ¹
        projected. θ moves by α₁ s, so by α₁ radius at the most: by 0.002 with a radius of 0.1 and α₁ = 0.02. With
        `restoring` s solves a problem like that of constrained policy optimization (Achiam et al. 2017), but only on
        the active constraints and with b = −(αₑ/α₁) min(slack, 0), where CPO has b = −slack for all: a constraint that
        is met with slack may be broken in one step. Restorations v know no radius. The solver should have
        `takes_geometry` for a radius; a metric asks nothing of it: the gradients are taken to the coordinates where
        M = I, whatever follows is Euclidean there, and the change is brought back.
    on_failure: a subproblem neither OPTIMAL nor INFEASIBLE is handed to active-set ("fallback"), leaves θ as it
        is ("skip"), or raises DirectionError ("raise"). A fallback that fails too is skipped.
    """

    solver: DirectionSolver | str = field(default_factory=lambda: SOLVERS["active-set"])
    formulation: str = "equality"
    rule: ActiveSetRule | str = violated
    step_size: Number = 0.02
    restoration_rate: Number = 0.02
    drop: str = "stationary"
    raw_multipliers: bool = False
    ridge: Number = 0.0
    max_restoration: Number = np.inf
    on_failure: str = "fallback"
    metric: ArrayLike | None = field(default=None, compare=False)
    radius: Number | None = None
    _metric_bytes: bytes = field(default=b"", init=False, repr=False)  # by which steps compare and hash

    def __post_init__(self) -> None:
        if isinstance(self.solver, str):
            object.__setattr__(self, "solver", solver_named(self.solver))
        if isinstance(self.rule, str):
            require_member("rule", self.rule, tuple(ACTIVE_SET_RULES))
            object.__setattr__(self, "rule", ACTIVE_SET_RULES[self.rule])
        if isinstance(self.solver, type) or not callable(getattr(self.solver, "solve", None)):
            raise ValueError(f"solver should be a name or have a method solve(problem); found {self.solver!r}")
        if not callable(self.rule):
            raise ValueError(f"rule should be a name or a function (slack, previous) → mask; found {self.rule!r}")
        if not isinstance(self.raw_multipliers, bool | np.bool_):
            raise ValueError(f"raw_multipliers should be True or False; found {self.raw_multipliers!r}")
        require_member("formulation", self.formulation, tuple(FORMULATIONS))
        require_member("drop", self.drop, DROP_RULES)
        require_member("on_failure", self.on_failure, ON_FAILURE)
        for name in ("step_size", "restoration_rate", "ridge"):
            require_nonnegative(name, getattr(self, name))
        require_nonnegative("max_restoration", self.max_restoration, allow_infinite=True)
        for name in ("step_size", "restoration_rate", "ridge", "max_restoration", "radius"):
            if isinstance(getattr(self, name), np.ndarray):  # of no axes; steps compare and hash by their numbers
                object.__setattr__(self, name, getattr(self, name)[()])
        if self.formulation == "restoring" and self.step_size == 0:
            raise ValueError("step_size should be > 0 with formulation 'restoring', which divides by it; found 0")
        if self.formulation == "restoring" and not float(self.restoration_rate) / float(self.step_size) < np.inf:
            raise ValueError(
                "restoration_rate / step_size should be finite with formulation 'restoring'; found "
                f"{self.restoration_rate!r} / {self.step_size!r}"
            )
        if self.radius is not None:
            require_positive("radius", self.radius)
        if self.radius is not None and not facts_of(self.solver).takes_geometry:
            raise ValueError(
                f"solver should take a radius; found {self.solver!r}, which does not say so. Wrap it: "
                "cpgrl_opt.WithGeometry(solver)"
            )
        if self.metric is not None:
            metric, whitening = validated_metric(self.metric, len(np.atleast_1d(np.asarray(self.metric))))
            vars(self).update(metric=metric, _whitening=whitening, _metric_bytes=metric.tobytes())
        object.__setattr__(self, "_direct", self._usual_way())

    def _usual_way(self) -> tuple[Any, ...] | None:
        """Arguments of `direct_step.move`; None where these settings need more than it does."""
        is_plain = self.ridge == 0 and self.max_restoration == np.inf and self.radius is None
        drops_always = self.formulation == "equality" and self.drop == "always"
        if type(self.solver) not in CLOSED_FORM or not is_plain or drops_always:
            return None
        formulation = FORMULATIONS[self.formulation]
        solver = type(self.solver) is Rosen, formulation.is_equality, formulation.restores_inside
        rates = float(self.step_size), float(self.restoration_rate), tolerance_of(self.solver)
        return *solver, *rates, NEGLIGIBLE

    def usual_way(self, m: int, n: int) -> tuple[Any, ...] | None:
        """Arguments of `direct_step.move` after 𝒜 = {i : slackᵢ ≤ 0}, where that is all of a step; None where not."""
        needs_more = self.rule is not violated or self.metric is not None or is_long(m, n)
        return None if needs_more else vars(self).get("_direct")

    @cached_property
    def _whitening(self) -> Whitening | None:
        """L of M = LLᵀ; None where M = I."""
        return None if self.metric is None else validated_metric(self.metric, len(self.metric))[1]  # type: ignore[arg-type]

    def __call__(
        self,
        linearization: Linearization,
        thresholds: ArrayLike,
        previous: ArrayLike | None = None,
        observe: Observer | None = None,
    ) -> StepResult:
        """The change of θ that climbs Δ¹ while the active constraints hold or are restored.

        thresholds: (m,), Gⁱ. previous: the last result's `active`, for rules with memory. observe: sees every
        subproblem with its answer: where M = I, of (JL⁻ᵀ, L⁻¹g) for M = LLᵀ; for long gradients run by run, in 1 + m
        coordinates. Raises ValueError when thresholds or metric do not fit, DirectionError if so set,
        FloatingPointError where rates times directions overflow.
        """
        limits = real_values("thresholds", thresholds)
        require_shape("thresholds", limits, (linearization.gradients.shape[-2] - 1,))
        slack = np.ascontiguousarray(linearization.slack(limits))
        if not is_finite(slack):  # the linearization is finite
            finite_array("thresholds", limits, 1)
            raise ValueError("values − thresholds should be finite; found one that overflows")
        active = self._active(slack, previous)
        whitening = self._whitening  # other ways to M⁻¹ find their own coordinates here, as `step_in_span` does
        if whitening is None:
            return self._where_identity(linearization, slack, active, observe)
        n = linearization.gradients.shape[-1]
        require_shape("metric", self.metric, (n,) * self.metric.ndim)  # type: ignore[union-attr, arg-type]
        result = self._where_identity(linearization.whitened(whitening), slack, active, observe)
        return replace(result, change=_original(whitening, result.change))

    def _where_identity(
        self, linearization: Linearization, slack: np.ndarray, active: np.ndarray, observe: Observer | None
    ) -> StepResult:
        """The step in coordinates where M = I; long gradients in those of their span."""
        if linearization.is_long:
            results = step_in_span(self._on_rows, linearization.vectors, slack, active, float(self.step_size), observe)
            return _stack(results, active, linearization.gradients.shape[-1]) if slack.ndim > 1 else results[0]
        return self._on_rows(linearization.gradients, slack, active, observe)

    def _on_rows(
        self,
        gradients: Float[np.ndarray, "*runs channels n"],
        slack: np.ndarray,
        active: np.ndarray,
        observe: Observer | None,
    ) -> StepResult:
        runs, (channels, n) = slack.shape[:-1], gradients.shape[-2:]
        gradients = np.ascontiguousarray(gradients)
        if not gradients.flags.writeable:  # JAX hands out such arrays; the compiled helpers take them for another type
            gradients = gradients.copy()
        count = math.prod(runs)
        stacked = (
            gradients.reshape(count, channels, n),
            slack.reshape(count, channels - 1),
            active.reshape(count, channels - 1),
        )
        direct = vars(self).get("_direct")  # not there in steps that were pickled before it was
        if observe is None and direct is not None and count > 0:
            change, flat = np.empty((count, n)), np.empty(count, np.int64)
            if direct_step().move.run(*stacked, *direct, flat, change):
                return usual_result(change.reshape(*runs, n), active, flat.reshape(runs))
        run = StepRun(self, observe, count)
        change, stationary = run.step(run.admit(*stacked))
        found = {name: counted.reshape(runs) for name, counted in run.counted().items()}
        return StepResult(change.reshape(*runs, n), active, stationary.reshape(runs), found)

    def _active(self, slack: np.ndarray, previous: ArrayLike | None) -> Bool[np.ndarray, "*runs m"]:
        """What the rule chooses, copied, since it may use its array again; what it is handed cannot be written to."""
        if previous is not None:
            previous = boolean_array("previous", previous)
            require_shape("previous", previous, slack.shape)
        try:
            active = np.array(self.rule(read_only(slack), previous), order="C")  # type: ignore[operator]
        except ValueError as error:
            if "read-only" in str(error):
                raise ValueError(f"rule should work on copies; found {self.rule!r}, which wrote: {error}") from error
            raise
        if active.dtype != np.bool_ or active.shape != slack.shape:
            raise ValueError(
                f"rule should return booleans of shape {slack.shape}; found {active.dtype} of shape {active.shape}, "
                f"from {self.rule!r}"
            )
        return active


def usual_result(
    change: Float[np.ndarray, "*runs n"], active: Bool[np.ndarray, "*runs m"], flat: Int[np.ndarray, "*runs"]
) -> StepResult:
    """What `direct_step.move` did: nothing but `flat` is counted."""
    counts = {**dict.fromkeys(COUNTS, nothing(flat.shape)), "flat": flat}
    return StepResult(change, active, np.zeros(flat.shape, np.bool_), counts)


def _original(whitening: Whitening, change: Float[np.ndarray, "*runs n"]) -> Float[np.ndarray, "*runs n"]:
    """L⁻ᵀx of every run; FloatingPointError where one overflows."""
    original = np.empty(change.shape)
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        for run in np.ndindex(change.shape[:-1]):
            original[run] = whitening.original(change[run])
    if not is_finite(original):
        raise FloatingPointError(
            "the change of θ should be finite; found one that overflows in the units of the metric"
        )
    return original


def _stack(results: list[StepResult], active: np.ndarray, n: int) -> StepResult:
    """Results of runs one by one, with the axes of the linearization."""
    runs = active.shape[:-1]
    change = np.array([each.change for each in results]).reshape(*runs, n)
    stationary = np.array([each.stationary for each in results], dtype=np.bool_).reshape(runs)
    counts = {name: np.array([each.counts[name] for each in results], dtype=np.int64).reshape(runs) for name in COUNTS}
    return StepResult(change, active, stationary, counts)


@cache
def direct_step() -> Any:
    """The module of the usual way; imports numba."""
    from . import direct_step as compiled

    return compiled
