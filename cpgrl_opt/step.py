"""One step of a constrained learner: rule → formulation → solver → safeguards → parameter change.

θ ← θ + α₁ s + αₑ v        (eq. 8 of the paper, v = −d)
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np

from .active_set import ACTIVE_SET_RULES, ActiveSetRule, violated
from .arrays import ArrayLike, Bool, Float, Int, Number
from .direction import DirectionBatch, DirectionError, Status
from .drop_rule import NEGLIGIBLE, has_positive_multipliers, leaving_constraints, tangents, vanishing
from .formulation import FORMULATIONS, ActiveConstraints, least_norm_restorations, step_kernels
from .linearization import Linearization
from .problem import ProblemBatch
from .reduction import RUNGS, coordinates
from .scaling import lengths
from .solvers import (
    SELF_JUDGING,
    SOLVERS,
    ActiveSet,
    DirectionSolver,
    Rosen,
    facts_of,
    refereed,
    solve_batch,
    solver_named,
    tolerance_of,
)
from .step_geometry import StepGeometry
from .validation import (
    ReadOnlyArrays,
    boolean_array,
    finite_array,
    is_finite,
    read_only,
    real_values,
    require_member,
    require_nonnegative,
    require_shape,
)
from .vectors import ArrayVectors, is_long

Observer = Callable[[ProblemBatch, DirectionBatch], None]

DROP_RULES = ("never", "stationary", "always")
ON_FAILURE = ("fallback", "skip", "raise")
# The coordinates of rows at an angle θ are rounded, which tilts them by eps/θ, and nothing mends a step as a solve is
# mended: 1e-4 rad leave 1e-12 of it.
_CLEAR_ROWS = 1e-8
# Of their answers PΔ¹ = 0 is seen as well as by the closed form.
_EXACT = (ActiveSet, Rosen)


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


_COUNTS = ("infeasible", "fallback", "skipped", "dropped", "capped", "softened", "flat")


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
        `takes_geometry`.
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
        geometry = StepGeometry.of(self.metric, self.radius)
        if geometry is not None and not facts_of(self.solver).takes_geometry:
            raise ValueError(
                f"solver should take metric and radius; found {self.solver!r}, which does not say so. Wrap it: "
                "cpgrl_opt.WithGeometry(solver)"
            )
        if geometry is not None and geometry.metric is not None:
            object.__setattr__(self, "metric", geometry.metric)
            object.__setattr__(self, "_metric_bytes", geometry.metric.tobytes())
        object.__setattr__(self, "_geometry", geometry)
        object.__setattr__(self, "_direct", self._usual_way())

    def _usual_way(self) -> tuple[Any, ...] | None:
        """Arguments of `direct_step.move`; None where these settings need more than it does."""
        is_plain = self.ridge == 0 and self.max_restoration == np.inf and self._geometry is None  # type: ignore[attr-defined]
        formulation = FORMULATIONS[self.formulation]
        if (
            type(self.solver) not in _EXACT
            or not is_plain
            or (self.formulation == "equality" and self.drop == "always")
        ):
            return None
        solver = type(self.solver) is Rosen, formulation.is_equality, formulation.restores_inside
        rates = float(self.step_size), float(self.restoration_rate), tolerance_of(self.solver)
        return *solver, *rates, NEGLIGIBLE

    def usual_way(self, m: int, n: int) -> tuple[Any, ...] | None:
        """Arguments of `direct_step.move` after 𝒜 = {i : slackᵢ ≤ 0}, where that is all of a step; None where not."""
        return None if self.rule is not violated or is_long(m, n) else vars(self).get("_direct")

    def __call__(
        self,
        linearization: Linearization,
        thresholds: ArrayLike,
        previous: ArrayLike | None = None,
        observe: Observer | None = None,
    ) -> StepResult:
        """The change of θ that climbs Δ¹ while the active constraints hold or are restored.

        thresholds: (m,), Gⁱ. previous: the last result's `active`, for rules with memory. observe: sees every
        subproblem with its answer; for long gradients run by run, in 1 + m coordinates. Raises ValueError when
        thresholds do not fit, DirectionError if so set, FloatingPointError where rates times directions overflow.
        """
        limits = real_values("thresholds", thresholds)
        require_shape("thresholds", limits, (linearization.gradients.shape[-2] - 1,))
        slack = np.ascontiguousarray(linearization.slack(limits))
        if not is_finite(slack):  # the linearization is finite
            finite_array("thresholds", limits, 1)
            raise ValueError("values − thresholds should be finite; found one that overflows")
        active = self._active(slack, previous)
        if linearization.is_long and self._geometry is None:  # type: ignore[attr-defined]
            return self._in_span(linearization, slack, active, observe)
        return self._on_rows(linearization.gradients, slack, active, observe)

    def _in_span(
        self, linearization: Linearization, slack: np.ndarray, active: np.ndarray, observe: Observer | None
    ) -> StepResult:
        """Run by run in the 1 + m coordinates of its own gradients: `observe` sees the subproblems in these."""
        results = []
        for run, vectors in zip(np.ndindex(slack.shape[:-1]), linearization.vectors, strict=True):
            results.append(self._one_in_span(vectors, slack[run], active[run], observe))
        if slack.ndim == 1:
            return results[0]
        runs = slack.shape[:-1]
        change = np.array([each.change for each in results]).reshape(*runs, linearization.gradients.shape[-1])
        stationary = np.array([each.stationary for each in results], dtype=np.bool_).reshape(runs)
        counts = {
            name: np.array([each.counts[name] for each in results], dtype=np.int64).reshape(runs) for name in _COUNTS
        }
        return StepResult(change, active, stationary, counts)

    def _one_in_span(
        self, vectors: ArrayVectors, slack: np.ndarray, active: np.ndarray, observe: Observer | None
    ) -> StepResult:
        seen: list[tuple[ProblemBatch, DirectionBatch]] = []
        see = None if observe is None else lambda *pair: seen.append(pair)
        for rung in RUNGS:
            small = coordinates(vectors, active, rung, clear=_CLEAR_ROWS)
            if small is None:
                continue
            seen.clear()
            try:
                result = self._on_rows(np.vstack([small.gradient, small.jacobian]), slack, active, see)
            except DirectionError:  # the rows may have what their coordinates have not
                continue
            if result.counts["skipped"]:
                continue
            change, certificate = vectors.combine(small.weights(result.change), np.zeros(len(slack)))
            unit = float(lengths(result.change)) + float(self.step_size * small.lengths[0])
            if small.holds(result.change, certificate, unit):
                for pair in seen if observe is not None else ():
                    observe(*pair)  # type: ignore[misc]
                return replace(result, change=change)
        return self._on_rows(np.vstack([vectors.gradient, vectors.jacobian]), slack, active, observe)

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
            if direct_step().move(*stacked, *direct, flat, change):
                return usual_result(change.reshape(*runs, n), active, flat.reshape(runs))
        run = _Run(self, observe, count)
        change, stationary = run.step(run.admitted(*stacked))
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
    counts = {**dict.fromkeys(_COUNTS, _nothing(flat.shape)), "flat": flat}
    return StepResult(change, active, np.zeros(flat.shape, np.bool_), counts)


@cache
def direct_step() -> Any:
    """The module of the usual way; imports numba."""
    from . import direct_step as compiled

    return compiled


@cache
def _nothing(runs: tuple[Any, ...]) -> Int[np.ndarray, "*runs"]:
    zeros = np.zeros(runs, np.int64)
    zeros.flags.writeable = False
    return zeros


class _Run:
    """One call of a step: carries the counts while the pieces below do the work."""

    def __init__(self, settings: ConstrainedStep, observe: Observer | None, runs: int) -> None:
        self.settings = settings
        self.observe = observe
        self.runs = runs
        self.any_skipped = False
        self._counts: dict[str, np.ndarray] | None = None
        self.geometry: StepGeometry | None = settings._geometry  # type: ignore[attr-defined]

    @property
    def counts(self) -> dict[str, Int[np.ndarray, "B"]]:
        """To be added to. Made when something happens: in most updates nothing does."""
        if self._counts is None:
            self._counts = dict(zip(_COUNTS, np.zeros((len(_COUNTS), self.runs), np.int64), strict=True))
        return self._counts

    def counted(self) -> Mapping[str, Int[np.ndarray, "B"]]:
        """The counts, read only where all are 0."""
        return dict.fromkeys(_COUNTS, _nothing((self.runs,))) if self._counts is None else self._counts

    def step(self, constraints: ActiveConstraints) -> tuple[np.ndarray, np.ndarray]:
        """The change of θ (B, n) and whether a run is stationary (B,)."""
        settings, n = self.settings, constraints.gradients.shape[2]
        if self.geometry is not None:
            more = constraints.target.shape[1] if settings.ridge > 0 else 0
            self.geometry = self.geometry.for_parameters(n, more)
        if settings.ridge > 0:
            constraints = constraints.softened(settings.ridge)
            self.counts["softened"] += constraints.active.any(axis=1)
        if settings.max_restoration < np.inf:
            constraints = self.capped(constraints, n)
        tangent, restoration = self.solve(constraints, np.arange(len(constraints.target)))
        still, any_still = self.at_rest(tangent, constraints)
        if settings.formulation == "equality" and (any_still or settings.drop == "always"):
            if settings.drop == "never":
                still[still] = ~has_positive_multipliers(constraints.rows(still), self.geometry)
            else:
                tangent, restoration, still = self.drop(constraints, tangent, restoration, still)
        change = settings.step_size * tangent
        if restoration is not None and settings.max_restoration < np.inf and settings.formulation == "cone":
            restoration = restoration * self.shortening(restoration, n)[:, None]  # J v ≥ t: v is as long as t is
        if restoration is not None:
            change += settings.restoration_rate * restoration
        if self.any_skipped:
            skipped = self.counts["skipped"] > 0
            change[skipped], still[skipped] = 0.0, False  # the zeros of a failed solver are no optimum
        if not is_finite(change):
            raise FloatingPointError(
                f"the change of θ should be finite; found {change[~np.isfinite(change)][0]}, with step_size "
                f"{settings.step_size:g}, restoration_rate {settings.restoration_rate:g} and gradients up to "
                f"{np.abs(constraints.gradients).max():g}: lower the rates"
            )
        return change[:, :n], still

    def admitted(
        self, gradients: Float[np.ndarray, "B channels n"], slack: np.ndarray, active: np.ndarray
    ) -> ActiveConstraints:
        """𝒜 without the constraints whose gradient is 0, and t = −min(slack, 0)."""
        target, kept, flat = np.empty(slack.shape), np.empty(slack.shape, np.bool_), np.empty(self.runs, np.int64)
        any_flat, extreme = step_kernels().admit(gradients, slack, active, target, kept, flat)
        if any_flat:
            self.counts["flat"][:] = flat
        constraints = ActiveConstraints(gradients, target, kept)
        return constraints.balanced() if extreme and self.settings.ridge == 0 else constraints

    def capped(self, constraints: ActiveConstraints, n: int) -> ActiveConstraints:
        """t shortened so that αₑ‖J⁺t‖, and in `restoring` αₑ‖v‖ with the v of `cone`, are ≤ max_restoration."""
        factor = self.shortening(self.measured(Rosen(), least_norm_restorations(constraints)), n)
        if self.settings.formulation == "restoring":
            v = self.measured(ActiveSet(), least_norm_restorations(constraints, "cone"))
            factor = np.minimum(factor, self.shortening(v, n))
        return replace(constraints, target=constraints.target * factor[:, None])

    def measured(self, solver: DirectionSolver, problems: ProblemBatch) -> Float[np.ndarray, "B n"]:
        """The restorations, to be measured; a failure is treated as one of the step's own."""
        if self.geometry is not None:
            problems = self.geometry.restoration(problems)
        answers = solve_batch(solver, problems)
        if (answers.status > Status.INFEASIBLE).any():
            answers = self.mended(problems, answers, np.arange(len(answers)))
        return answers.value

    def shortening(self, moves: Float[np.ndarray, "B any"], n: int) -> Float[np.ndarray, "B"]:
        """The factor ≤ 1 with αₑ‖v‖ ≤ max_restoration in the n parameters; what a ridge adds to them moves no θ."""
        moves = moves.copy()
        moves[:, n:] = 0.0
        size = lengths(moves) if self.geometry is None else self.geometry.lengths(moves)
        length = self.settings.restoration_rate * size
        too_long = length > self.settings.max_restoration
        self.counts["capped"] |= too_long
        return np.where(too_long, self.settings.max_restoration / np.where(too_long, length, 1.0), 1.0)

    def solve(
        self, constraints: ActiveConstraints, runs: Int[np.ndarray, "chosen"]
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Tangent s and restoration v, None where it is inside."""
        settings = self.settings
        ratio = settings.restoration_rate / settings.step_size if settings.step_size else 0.0
        problems, count = FORMULATIONS[settings.formulation].problems(constraints, ratio), len(runs)
        if self.geometry is not None:
            tangents = self.certified(self.geometry.tangent(problems[:count]), runs)
            apart = len(problems) > count
            moves = self.certified(self.geometry.restoration(problems[count:]), runs).value if apart else None
            return tangents.value, moves
        answers = self.certified(problems, runs)
        return answers.value[:count], answers.value[count:] if len(answers) > count else None

    def certified(self, problems: ProblemBatch, runs: Int[np.ndarray, "chosen"]) -> DirectionBatch:
        """Answers that are OPTIMAL or INFEASIBLE, the rest handed on as `on_failure` says; failures counted."""
        solver: DirectionSolver = self.settings.solver  # type: ignore[assignment]
        answers = solve_batch(solver, problems)
        if type(solver) not in SELF_JUDGING:  # a subclass may do anything
            answers = refereed(problems, answers, tolerance_of(solver))
        if self.observe is not None:
            self.observe(problems, answers.protected())
        if np.count_nonzero(answers.status):
            members = np.resize(runs, len(answers))
            answers = self.mended(problems, answers, members)
            np.add.at(self.counts["infeasible"], members[answers.status == Status.INFEASIBLE], 1)
        return answers

    def mended(
        self, problems: ProblemBatch, answers: DirectionBatch, runs: Int[np.ndarray, "problems"]
    ) -> DirectionBatch:
        """The failures handed on."""
        failed = answers.status > Status.INFEASIBLE
        if failed.any() and self.settings.on_failure == "raise":
            raise DirectionError(str(Status(int(answers.status[failed][0]))))
        if failed.any() and self.settings.on_failure == "fallback":
            np.add.at(self.counts["fallback"], runs[failed], 1)
            again = ActiveSet().solve_batch(problems.chosen(failed))
            answers = answers.replaced(failed, again)
            if self.observe is not None:
                self.observe(problems.chosen(failed), again.protected())
        skipped = runs[answers.status > Status.INFEASIBLE]
        self.counts["skipped"][skipped] = 1
        self.any_skipped = self.any_skipped or skipped.size > 0
        return answers

    def drop(
        self,
        constraints: ActiveConstraints,
        tangent: np.ndarray,
        restoration: np.ndarray | None,
        still: Bool[np.ndarray, "B"],
    ) -> tuple[np.ndarray, np.ndarray | None, Bool[np.ndarray, "B"]]:
        """𝒜 ← 𝒜 without the largest λ, until some λ ≤ 0 exists; P and d are built anew. See `drop_rule`. §2.3.

        Returns s, v, and whether PΔ¹ = 0 at the end of it.
        """
        tangent = tangent.copy()  # an observer may have kept the answers
        restoration = None if restoration is None else restoration.copy()
        active = constraints.active.copy()
        open_ = still if self.settings.drop == "stationary" else active.any(axis=1)
        for _ in range(active.shape[1]):
            chosen = np.flatnonzero(open_ & (self.counts["skipped"] == 0) if self.any_skipped else open_)
            chosen = chosen[has_positive_multipliers(constraints.rows(chosen, active), self.geometry)]
            if not chosen.size:
                break
            before = constraints.rows(chosen, active)
            active[chosen] &= ~leaving_constraints(before, self.geometry, raw=self.settings.raw_multipliers)
            fewer = constraints.rows(chosen, active)
            self.counts["dropped"][chosen] += np.count_nonzero(before.active & ~fewer.active, axis=1)
            tangent[chosen], again = self.solve(fewer, chosen)
            if restoration is not None:
                restoration[chosen] = again
            still[chosen] = self.at_rest(tangent[chosen], fewer)[0]
            open_ = np.isin(np.arange(len(active)), chosen) & (still | (self.settings.drop == "always"))
        return tangent, restoration, still

    def at_rest(self, tangent: np.ndarray, constraints: ActiveConstraints) -> tuple[Bool[np.ndarray, "B"], bool]:
        """PΔ¹ = 0 up to rounding, by run, and whether in any; with `equality` whatever the solver's tolerance."""
        if self.settings.formulation == "equality" and type(self.settings.solver) not in _EXACT:
            tangent = tangents(constraints, self.geometry)
        return vanishing(tangent, constraints, self.geometry)
