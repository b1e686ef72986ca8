"""One step of a constrained learner: rule → formulation → solver → safeguards → parameter change.

θ ← θ + α₁ s + αₑ v        (eq. 8 of the paper, v = −d)
"""

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ._gate import metric_of_rows, require_no_metric
from ._step_run import StepRun
from ._violation import is_missed
from .active_set import violated
from .arrays import ArrayLike, Bool
from .direct_step import move_parameters
from .direction import DirectionError
from .formulation import FORMULATIONS
from .linearization import Linearization, convert_runs
from .metric import check_metric
from .metric_operator import OperatorMetric
from .scaling import lengths
from .step_in_span import step_in_metric, step_in_span
from .step_result import StepResult, skipped_result, stack_results, usual_result
from .step_settings import DROP_RULES, ON_FAILURE, Observer, StepSettings
from .validation import boolean_array, finite_array, is_finite, read_only, real_values, require_shape

__all__ = ["DROP_RULES", "ON_FAILURE", "ConstrainedStep", "Observer", "StepResult", "usual_result"]


@dataclass(frozen=True, kw_only=True)
class ConstrainedStep(StepSettings):
    """Settings of a step; calling it maps a linearization to a `StepResult`.

    solver, rule: objects, or the names of SOLVERS, ACTIVE_SET_RULES; formulation: a name of FORMULATIONS. What a
        solver that is not of SOLVERS calls OPTIMAL or INFEASIBLE is put before the referee here.
    step_size α₁ and restoration_rate αₑ: ≥ 0 (the paper: both 0.02), α₁ > 0 for `restoring` and `linearized`. α₁ is
        0.02 where it is not given, and 1 with a radius.
    slack_fraction κ in [0, 1], of `linearized` alone: in a step a constraint loses no more than this part of its slack,
        to first order. κ ≥ αₑ is advised: where rows and slacks sum to 0, as on the three-state MDP, nothing
        meets all constraints with κ < αₑ once one is violated. What nothing meets is counted `infeasible`: then those
        that are violated are violated least while the others are met (see `recovery`), as constrained policy
        optimization recovers. Its rule is the default.
    drop: which constraints `equality` takes out of 𝒜 (§2.3): "stationary", argmax λᵢ‖Jᵢ‖ while PΔ¹ = 0 and no λ ≤ 0
        exists; "always", whether PΔ¹ = 0 or not; "never". λ is the step's own, of dependent rows the one of least norm,
        and what ties leaves together, so that neither the solver nor the order of the constraints decides: see
        `drop_rule`. raw_multipliers compares λᵢ instead, as printed.
    ridge ε ≥ 0: softens the constraints, (JJᵀ + εI)⁻¹ in P and d, JM⁻¹Jᵀ in a metric; in the squared unit of a
        gradient; 0 with `linearized`. Ours.
    max_restoration: restoration shortened to ‖αₑ J⁺ min(slack, 0)‖ ≤ max_restoration, in the unit of θ (in the
        metric's where there is one). Where rows depend, J⁺ answers by least squares and may be much shorter than the v
        of `cone`: then αₑ‖v‖ ≤ max_restoration too, in `cone`, and in `restoring` and `linearized`, where that v is
        inside. `linearized` shortens what it asks of violated constraints, and J has the rows of these alone. Ours.
    metric M: (n,) positive, a tree of positive arrays with the structure of the gradients (keys in any order), (n, n)
        symmetric positive definite, or a function v ↦ Mv: s, v and their lengths are taken
        in it (a natural gradient where M is the Fisher matrix). metric_tolerance, metric_iterations: of M⁻¹ by
        conjugate gradients where M is a function, as in `DirectionProblem`; a run for which they are not enough is
        counted `skipped`. A metric asks nothing of the solver: the gradients are taken to the coordinates where M = I,
        whatever follows is Euclidean there, and the change is brought back.
    radius > 0: s climbs most in sᵀMs ≤ radius², instead of being Δ¹ projected. To the solver's tolerance
        ‖change‖_M ≤ α₁ radius with `restoring` and `linearized`. With `equality` and `cone` α₁ s alone is as short:
        restorations v know no radius, and a change that they make longer is counted `long`. `linearized` with
        κ = α₁ = αₑ = 1 is constrained policy optimization (Achiam et al. 2017, eq. 10) for any number of constraints,
        Js ≥ −slack, without its line search; `restoring` is not: it has the active constraints alone, so that one with
        slack may be broken in one step. The solver should have `takes_geometry`.
    on_failure: a subproblem neither OPTIMAL nor INFEASIBLE is handed to active-set ("fallback"), leaves θ as it
        is ("skip"), or raises DirectionError ("raise"). A fallback that fails too is skipped.
    """

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
        if not isinstance(linearization, Linearization):
            raise ValueError(f"linearization should be a Linearization; found {linearization!r}")
        if linearization.is_tree:
            given = linearization, thresholds, previous, observe
            slack, active = linearization.vectors[0].agree(self._slack_and_active, *given)
        else:
            slack, active = self._slack_and_active(linearization, thresholds, previous, observe)
        if self.metric is None and not linearization.is_tree and not linearization.is_long:
            return self._on_rows(linearization.gradients, slack, active, observe)
        return self._in_coordinates(linearization, slack, active, observe)

    def _slack_and_active(
        self, linearization: Linearization, thresholds: ArrayLike, previous: ArrayLike | None, observe: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        if observe is not None and not callable(observe):
            raise ValueError(f"observe should be a function (problems, answers) or None; found {observe!r}")
        limits = real_values("thresholds", thresholds)
        require_shape("thresholds", limits, (linearization.values.shape[-1] - 1,))
        slack = linearization.slack(limits)
        if not is_finite(slack):  # the linearization is finite
            finite_array("thresholds", limits, 1)
            raise ValueError("values − thresholds should be finite; found one that overflows")
        if linearization.is_tree:
            require_no_metric(linearization.vectors[0], self.metric)
        return slack, self._active(slack, previous)

    def _in_coordinates(
        self, given: Linearization, slack: np.ndarray, active: np.ndarray, observe: Observer | None
    ) -> StepResult:
        """Where M = I, and of few numbers: one array of float64, or the coordinates of the gradients' span."""
        whitening = self._whitening
        if self.metric_is_tree:
            if not given.is_tree:
                raise ValueError("metric should be an array or a function where gradients are no tree; found a tree")
            whitening = check_metric(metric_of_rows(given.vectors[0], self.metric), given.n)[1]
        elif whitening is not None:
            require_shape("metric", self.metric, (given.n,) * self.metric.ndim)  # type: ignore[union-attr, arg-type]
        flat = given if whitening is None else given.whiten(whitening)
        runs, before = slack.shape[:-1], None if self.metric is None else given.gradients
        if math.prod(runs) and (callable(self.metric) or flat.is_long):
            rows = [None] * math.prod(runs) if before is None else _stack(runs, before)[0]
            each = zip(rows, flat.vectors, *_stack(runs, slack, active), strict=True)
            result = stack_results([self._of_run(*run, observe=observe) for run in each], runs)
        else:
            result = self._on_rows(flat.gradients, slack, active, observe, before)
        if whitening is not None:
            change = convert_runs(whitening.original, result.change, 1)
            if not is_finite(change):
                raise FloatingPointError("the change of θ should be finite; found inf in the units of the metric")
            result = replace(result, change=change)
        return replace(result, change=given.as_given(result.change)) if given.is_tree else result

    def _of_run(
        self, before: np.ndarray | None, vectors: Any, slack: np.ndarray, active: np.ndarray, *, observe: Any
    ) -> StepResult:
        """In the coordinates of a run's own gradients; what they do not answer is left, or raised."""
        on_rows = partial(self._on_rows, before=before)
        try:
            if callable(self.metric):
                return step_in_metric(on_rows, vectors, slack, active, self._operator(vectors), observe)
            return step_in_span(on_rows, vectors, slack, active, float(self.step_size), observe)  # type: ignore[arg-type]
        except DirectionError:
            if self.on_failure == "raise":
                raise
            zero = np.zeros(vectors.shape[1]) if vectors.has_rows else vectors.zero()
            return skipped_result(zero, slack, active & (not FORMULATIONS[self.formulation].takes_all))

    def _operator(self, vectors: Any) -> OperatorMetric:
        """Of n parameters, which only a linearization tells; looked at once, but of trees."""
        product, n = metric_of_rows(vectors, self.metric), vectors.shape[1]
        known: OperatorMetric | None = vars(self).get("_operator_metric")
        if known is None or known.n != n or known.product is not product:
            known = OperatorMetric(product, n, self.metric_tolerance, self.metric_iterations)
            vars(self)["_operator_metric"] = known
        return known

    def _on_rows(
        self, gradients: np.ndarray, slack: np.ndarray, active: np.ndarray, observe: Any, before: Any = None
    ) -> StepResult:
        """Where M = I: the usual way where it is all, else the long one. (…, 1 + m, n), (…, m), (…, m).

        before: the gradients in whose lengths constraints contradict each other, where there was a metric.
        """
        if not gradients.flags.carray:  # nor read-only, as JAX's are, which compiled helpers take for another type
            gradients = gradients.copy()
        runs, m, n = slack.shape[:-1], slack.shape[-1], gradients.shape[-1]
        count, direct = math.prod(runs), self._direct
        if before is not None and not (slack[active] < 0.0).any():
            before = None  # nothing is asked
        if observe is None and direct is not None and count > 0:
            flat, change = np.empty(runs, np.int64), np.empty((*runs, n))
            proof = np.empty((*runs, m)), np.empty((*runs, 4)), np.empty((*runs, m))
            given, found = _stack(runs, gradients, slack, active), _stack(runs, flat, change, *proof)
            if move_parameters.run(*given, direct, *found):
                result = usual_result(change, active, flat, proof)
                if before is None or not self._is_short_of(before, slack, active, result.predicted_slack):
                    return result
        before = None if before is None else _stack(runs, before)[0]
        return StepRun(self, observe, count, before).step(*_stack(runs, gradients, slack, active)).reshape(runs)

    def _is_short_of(self, gradients: np.ndarray, slack: np.ndarray, active: np.ndarray, predicted: Any) -> bool:
        """Whether a change restores less than it was asked to, in the rows' own lengths, or nobody can tell."""
        formulation = FORMULATIONS[self.formulation]
        if not (formulation.restores_inside or formulation.is_equality):  # the tangent may restore what v does not
            return True
        kept = float(self.slack_fraction) * np.maximum(slack, 0.0) if formulation.takes_all else 0.0
        asked = float(self.restoration_rate) * np.maximum(-slack, 0.0) - kept
        unit = lengths(gradients[..., 1:, :])
        unit = np.where(active & (unit > 0.0), unit, np.inf)  # of other rows a step asks nothing
        with np.errstate(over="ignore", invalid="ignore"):
            return is_missed(asked / unit, (predicted - slack - asked) / unit, formulation.is_equality)

    def _active(self, slack: np.ndarray, previous: ArrayLike | None) -> Bool[np.ndarray, "*runs m"]:
        """What the rule chooses, copied, since it may use its array again; what it is handed cannot be written to."""
        if previous is not None:
            previous = boolean_array("previous", previous)
            require_shape("previous", previous, slack.shape)
        if FORMULATIONS[self.formulation].takes_all:
            return np.ones(slack.shape, np.bool_)
        if self.rule is violated:  # no stranger: it needs no looking at
            return slack <= 0.0
        try:
            active = np.array(self.rule(read_only(slack), previous), order="C")  # type: ignore[operator]
        except ValueError as error:
            if "read-only" in str(error):
                raise ValueError(f"rule should work on copies; found {self.rule!r}, which wrote: {error}") from error
            raise
        if active.dtype != np.bool_ or active.shape != slack.shape:
            found = f"{active.dtype} of shape {active.shape}, from {self.rule!r}"
            raise ValueError(f"rule should return booleans of shape {slack.shape}; found {found}")
        return active


def _stack(runs: tuple[Any, ...], *arrays: np.ndarray) -> list[np.ndarray]:
    """The same with one axis of runs."""
    if not runs:  # the usual case, in a third of the time
        return [array[None] for array in arrays]
    return [array.reshape(math.prod(runs), *array.shape[len(runs) :]) for array in arrays]
