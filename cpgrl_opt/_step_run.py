"""One call of a step where M = I: formulation → solver → safeguards → change of θ."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .arrays import Bool, Float, Int
from .direction import DirectionBatch, DirectionError, Status
from .drop_rule import has_positive_multipliers, leaving_constraints, tangents, vanishing
from .formulation import FORMULATIONS, ActiveConstraints, least_norm_restorations
from .problem import ProblemBatch
from .recovery import recover
from .scaling import lengths
from .solvers import ActiveSet, DirectionSolver, Rosen, solve_batch, tolerance_of
from .step_kernels import admit, predict
from .step_result import COUNTS, StepResult, nothing
from .step_settings import CLOSED_FORM, StepSettings
from .validation import is_finite


@dataclass(frozen=True, eq=False)
class Moves:
    """Tangents or restorations of B runs: value (B, n), multipliers (B, m), residuals (B, 4), NaN where none."""

    value: Float[np.ndarray, "B n"]
    multipliers: Float[np.ndarray, "B m"]
    residuals: Float[np.ndarray, "B 4"]

    @classmethod
    def of(cls, answers: DirectionBatch) -> "Moves":
        """The answers' numbers."""
        known = answers.residuals
        return cls(answers.value, answers.multipliers, np.full((len(answers), 4), np.nan) if known is None else known)

    def copied(self) -> "Moves":
        """In arrays of its own."""
        return Moves(self.value.copy(), self.multipliers.copy(), self.residuals.copy())

    def put(self, runs: Int[np.ndarray, "part"], others: "Moves") -> None:
        """Those of some runs anew."""
        self.value[runs], self.multipliers[runs] = others.value, others.multipliers
        self.residuals[runs] = others.residuals


class StepRun:
    """One call of a step: carries the counts while the pieces below do the work."""

    def __init__(self, settings: StepSettings, observe: Any, runs: int) -> None:
        self.settings = settings
        self.observe = observe
        self.runs = runs
        self.takes_all = FORMULATIONS[settings.formulation].takes_all
        self.any_skipped = False
        self._counts: dict[str, np.ndarray] | None = None

    @property
    def counts(self) -> dict[str, Int[np.ndarray, "B"]]:
        """To be added to. Made when something happens: in most updates nothing does."""
        if self._counts is None:
            self._counts = dict(zip(COUNTS, np.zeros((len(COUNTS), self.runs), np.int64), strict=True))
        return self._counts

    def counted(self) -> Mapping[str, Int[np.ndarray, "B"]]:
        """The counts, read only where all are 0."""
        return dict.fromkeys(COUNTS, nothing((self.runs,))) if self._counts is None else self._counts

    def step(self, gradients: np.ndarray, slack: np.ndarray, active: np.ndarray) -> StepResult:
        """Of B runs: (B, 1 + m, n), (B, m), (B, m)."""
        n = gradients.shape[2]
        constraints = self.prepare(self.admit(gradients, slack, active), n)
        tangent, restoration = self.solve(constraints, np.arange(self.runs))
        tangent, restoration, still = self.settle(constraints, tangent, restoration)
        residuals = tangent.residuals if restoration is None else np.maximum(tangent.residuals, restoration.residuals)
        multipliers = np.where(constraints.active, constraints.original(tangent.multipliers), 0.0)
        change = self.change(tangent.value, None if restoration is None else restoration.value, n)
        if self.any_skipped:
            skipped = self.counts["skipped"] > 0
            change[skipped], still[skipped] = 0.0, False  # the zeros of a failed solver are no optimum
            multipliers[skipped] = 0.0
        if self.settings.radius is not None and restoration is not None:
            self.count_long(change)
        predicted = np.empty(slack.shape)
        predict(gradients, slack, change, predicted)
        active = multipliers > 0.0 if self.takes_all else active
        return StepResult(change, active, still, self.counted(), multipliers, residuals, predicted)

    def prepare(self, constraints: ActiveConstraints, n: int) -> ActiveConstraints:
        """The constraints with their ridge, and with what is asked of them within its limit."""
        if self.settings.ridge > 0:
            constraints = constraints.softened(self.settings.ridge)
            self.counts["softened"] += constraints.active.any(axis=1)
        if self.settings.max_restoration < np.inf:
            constraints = self.cap(constraints, n)
        return constraints.demands(float(self.settings.restoration_rate))

    def settle(
        self, constraints: ActiveConstraints, tangent: Moves, restoration: Moves | None
    ) -> tuple[Moves, Moves | None, Bool[np.ndarray, "B"]]:
        """s and v after the drop rule, and whether a run is stationary."""
        still, any_still = self.at_rest(tangent.value, constraints)
        if FORMULATIONS[self.settings.formulation].restores_inside and self._counts is not None:
            still &= self.counts["infeasible"] == 0  # where nothing meets the constraints, 0 is no KKT point
        if self.settings.formulation == "equality" and (any_still or self.settings.drop == "always"):
            if self.settings.drop != "never":
                return self.drop(constraints, tangent, restoration, still)
            still[still] = ~has_positive_multipliers(constraints.rows(still))
        return tangent, restoration, still

    def count_long(self, change: Float[np.ndarray, "B n"]) -> None:
        """Counts changes that are longer than α₁ radius by more than the solver's tolerance."""
        limit = self.settings.step_size * self.settings.radius * (1.0 + tolerance_of(self.settings.solver))  # type: ignore[operator]
        too_long = lengths(change) > limit
        if too_long.any():
            self.counts["long"] += too_long

    def change(self, tangent: np.ndarray, restoration: np.ndarray | None, n: int) -> Float[np.ndarray, "B n"]:
        """α₁ s + αₑ v of the n parameters."""
        settings = self.settings
        change = settings.step_size * tangent
        if restoration is not None and settings.max_restoration < np.inf and settings.formulation == "cone":
            restoration = restoration * self.shortening(restoration, n)[:, None]  # J v ≥ t: v is as long as t is
        if restoration is not None:
            change += settings.restoration_rate * restoration
        if not is_finite(change):
            raise FloatingPointError(
                f"the change of θ should be finite; found {change[~np.isfinite(change)][0]}, with step_size "
                f"{settings.step_size:g} and restoration_rate {settings.restoration_rate:g}: lower the rates"
            )
        return np.ascontiguousarray(change[:, :n])

    def admit(
        self, gradients: Float[np.ndarray, "B channels n"], slack: np.ndarray, active: np.ndarray
    ) -> ActiveConstraints:
        """𝒜 without the constraints whose gradient is 0, and t = −min(slack, 0)."""
        target, kept, flat = np.empty(slack.shape), np.empty(slack.shape, np.bool_), np.empty(self.runs, np.int64)
        any_flat, extreme = admit(gradients, slack, active, target, kept, flat)
        if any_flat:
            self.counts["flat"][:] = flat
        room = None
        if self.takes_all:
            room = float(self.settings.slack_fraction) * np.maximum(slack, 0.0)
        constraints = ActiveConstraints(gradients, target, kept, room=room)
        return constraints.balanced() if extreme and self.settings.ridge == 0 else constraints

    def cap(self, constraints: ActiveConstraints, n: int) -> ActiveConstraints:
        """t shortened so that αₑ‖J⁺t‖, and with a restoration inside αₑ‖v‖, v of `cone`, are ≤ max_restoration."""
        restored = constraints.violated() if self.takes_all else constraints
        factor = self.shortening(self.measure(Rosen(), least_norm_restorations(restored)), n)
        if FORMULATIONS[self.settings.formulation].restores_inside:
            v = self.measure(ActiveSet(), least_norm_restorations(restored, "cone"))
            factor = np.minimum(factor, self.shortening(v, n))
        return replace(constraints, target=constraints.target * factor[:, None])

    def measure(self, solver: DirectionSolver, problems: ProblemBatch) -> Float[np.ndarray, "B n"]:
        """The restorations, to be measured; a failure is treated as one of the step's own."""
        answers = solve_batch(solver, problems)
        if (answers.status > Status.INFEASIBLE).any():
            answers = self.hand_on(problems, answers, np.arange(len(answers)))
        return answers.value

    def shortening(self, moves: Float[np.ndarray, "B any"], n: int) -> Float[np.ndarray, "B"]:
        """The factor ≤ 1 with αₑ‖v‖ ≤ max_restoration in the n parameters; what a ridge adds to them moves no θ."""
        moves = moves.copy()
        moves[:, n:] = 0.0
        length = self.settings.restoration_rate * lengths(moves)
        too_long = length > self.settings.max_restoration
        self.counts["capped"] |= too_long
        return np.where(too_long, self.settings.max_restoration / np.where(too_long, length, 1.0), 1.0)

    def solve(self, constraints: ActiveConstraints, runs: Int[np.ndarray, "chosen"]) -> tuple[Moves, Moves | None]:
        """Tangent s and restoration v, None where it is inside."""
        settings = self.settings
        inside = 1.0 if self.takes_all else settings.restoration_rate  # which `demands` has taken in
        ratio = inside / settings.step_size if settings.step_size else 0.0
        problems, count = FORMULATIONS[settings.formulation].problems(constraints, ratio), len(runs)
        if settings.radius is not None:  # the tangent's alone: a restoration is the shortest move that restores
            in_ball = problems[:count].in_geometry(None, settings.radius)
            tangent, apart = Moves.of(self.solve_certified(in_ball, runs)), len(problems) > count
            return tangent, Moves.of(self.solve_certified(problems[count:], runs)) if apart else None
        answers = self.solve_certified(problems, runs)
        return Moves.of(answers[:count]), Moves.of(answers[count:]) if len(answers) > count else None

    def solve_certified(self, problems: ProblemBatch, runs: Int[np.ndarray, "chosen"]) -> DirectionBatch:
        """Answers that are OPTIMAL or INFEASIBLE, the rest handed on as `on_failure` says; failures counted."""
        solver: DirectionSolver = self.settings.solver  # type: ignore[assignment]
        answers = solve_batch(solver, problems)
        if self.observe is not None:
            self.observe(problems, answers.protected())
        if np.count_nonzero(answers.status):
            members = np.resize(runs, len(answers))
            answers = self.hand_on(problems, answers, members)
            infeasible = np.flatnonzero(answers.status == Status.INFEASIBLE)
            np.add.at(self.counts["infeasible"], members[infeasible], 1)
            if self.takes_all:
                answers = self.recover(problems, answers, infeasible)
        return answers

    def recover(
        self, problems: ProblemBatch, answers: DirectionBatch, infeasible: Int[np.ndarray, "part"]
    ) -> DirectionBatch:
        """Least violation of the violated rows alone, the others being met; see `recovery`."""
        answers = answers.owned()
        for k in infeasible.tolist():
            recovered = recover(problems[k], answers.value[k])
            if recovered is not None:  # the proof stays what it is
                answers.value[k] = recovered
        return answers

    def hand_on(
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
        self, constraints: ActiveConstraints, tangent: Moves, restoration: Moves | None, still: Bool[np.ndarray, "B"]
    ) -> tuple[Moves, Moves | None, Bool[np.ndarray, "B"]]:
        """𝒜 ← 𝒜 without the largest λ, until some λ ≤ 0 exists; P and d are built anew. See `drop_rule`. §2.3.

        Returns s, v, and whether PΔ¹ = 0 at the end of it.
        """
        tangent = tangent.copied()  # an observer may have kept the answers
        restoration = None if restoration is None else restoration.copied()
        active = constraints.active.copy()
        open_ = still if self.settings.drop == "stationary" else active.any(axis=1)
        for _ in range(active.shape[1]):
            chosen = np.flatnonzero(open_ & (self.counts["skipped"] == 0) if self.any_skipped else open_)
            chosen = chosen[has_positive_multipliers(constraints.rows(chosen, active))]
            if not chosen.size:
                break
            before = constraints.rows(chosen, active)
            active[chosen] &= ~leaving_constraints(before, raw=self.settings.raw_multipliers)
            fewer = constraints.rows(chosen, active)
            self.counts["dropped"][chosen] += np.count_nonzero(before.active & ~fewer.active, axis=1)
            moves, again = self.solve(fewer, chosen)
            tangent.put(chosen, moves)
            if restoration is not None and again is not None:
                restoration.put(chosen, again)
            still[chosen] = self.at_rest(moves.value, fewer)[0]
            open_ = np.isin(np.arange(len(active)), chosen) & (still | (self.settings.drop == "always"))
        return tangent, restoration, still

    def at_rest(self, tangent: np.ndarray, constraints: ActiveConstraints) -> tuple[Bool[np.ndarray, "B"], bool]:
        """PΔ¹ = 0 up to rounding, by run, and whether in any; with `equality` whatever the solver's tolerance."""
        radius = self.settings.radius
        if self.settings.formulation == "equality" and type(self.settings.solver) not in CLOSED_FORM:
            tangent = tangents(constraints, radius)
        if radius is None:
            return vanishing(tangent, constraints)
        still = np.logical_not(
            tangent.any(axis=1)
        )  # in a ball, where s is as long as the radius or 0, solvers round it themselves
        return still, bool(still.any())
