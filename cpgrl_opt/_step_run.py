"""One call of a step where M = I: formulation → solver → safeguards → change of θ."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from .arrays import Bool, Float, Int
from .direction import DirectionBatch, DirectionError, Status
from .drop_rule import has_positive_multipliers, leaving_constraints, tangents, vanishing
from .formulation import FORMULATIONS, ActiveConstraints, least_norm_restorations, step_kernels
from .problem import ProblemBatch
from .scaling import lengths
from .solvers import (
    ActiveSet,
    DirectionSolver,
    Rosen,
    solve_batch,
)
from .validation import is_finite

if TYPE_CHECKING:
    from .step import ConstrainedStep

COUNTS = ("infeasible", "fallback", "skipped", "dropped", "capped", "softened", "flat")
# Of their answers PΔ¹ = 0 is seen as well as by the closed form.
CLOSED_FORM = (ActiveSet, Rosen)


@cache
def nothing(runs: tuple[Any, ...]) -> Int[np.ndarray, "*runs"]:
    """Zeros that nobody can write to: what is counted in most updates."""
    zeros = np.zeros(runs, np.int64)
    zeros.flags.writeable = False
    return zeros


class StepRun:
    """One call of a step: carries the counts while the pieces below do the work."""

    def __init__(self, settings: "ConstrainedStep", observe: Any, runs: int) -> None:
        self.settings = settings
        self.observe = observe
        self.runs = runs
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

    def step(self, constraints: ActiveConstraints) -> tuple[np.ndarray, np.ndarray]:
        """The change of θ (B, n) and whether a run is stationary (B,)."""
        settings, n = self.settings, constraints.gradients.shape[2]
        if settings.ridge > 0:
            constraints = constraints.softened(settings.ridge)
            self.counts["softened"] += constraints.active.any(axis=1)
        if settings.max_restoration < np.inf:
            constraints = self.cap(constraints, n)
        tangent, restoration = self.solve(constraints, np.arange(len(constraints.target)))
        still, any_still = self.at_rest(tangent, constraints)
        if settings.formulation == "equality" and (any_still or settings.drop == "always"):
            if settings.drop == "never":
                still[still] = ~has_positive_multipliers(constraints.rows(still))
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

    def admit(
        self, gradients: Float[np.ndarray, "B channels n"], slack: np.ndarray, active: np.ndarray
    ) -> ActiveConstraints:
        """𝒜 without the constraints whose gradient is 0, and t = −min(slack, 0)."""
        target, kept, flat = np.empty(slack.shape), np.empty(slack.shape, np.bool_), np.empty(self.runs, np.int64)
        any_flat, extreme = step_kernels().admit(gradients, slack, active, target, kept, flat)
        if any_flat:
            self.counts["flat"][:] = flat
        constraints = ActiveConstraints(gradients, target, kept)
        return constraints.balanced() if extreme and self.settings.ridge == 0 else constraints

    def cap(self, constraints: ActiveConstraints, n: int) -> ActiveConstraints:
        """t shortened so that αₑ‖J⁺t‖, and in `restoring` αₑ‖v‖ with the v of `cone`, are ≤ max_restoration."""
        factor = self.shortening(self.measure(Rosen(), least_norm_restorations(constraints)), n)
        if self.settings.formulation == "restoring":
            v = self.measure(ActiveSet(), least_norm_restorations(constraints, "cone"))
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

    def solve(
        self, constraints: ActiveConstraints, runs: Int[np.ndarray, "chosen"]
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Tangent s and restoration v, None where it is inside."""
        settings = self.settings
        ratio = settings.restoration_rate / settings.step_size if settings.step_size else 0.0
        problems, count = FORMULATIONS[settings.formulation].problems(constraints, ratio), len(runs)
        if settings.radius is not None:  # the tangent's alone: a restoration is the shortest move that restores
            in_ball = self.solve_certified(problems[:count].in_geometry(None, settings.radius), runs).value
            apart = len(problems) > count
            return in_ball, self.solve_certified(problems[count:], runs).value if apart else None
        answers = self.solve_certified(problems, runs)
        return answers.value[:count], answers.value[count:] if len(answers) > count else None

    def solve_certified(self, problems: ProblemBatch, runs: Int[np.ndarray, "chosen"]) -> DirectionBatch:
        """Answers that are OPTIMAL or INFEASIBLE, the rest handed on as `on_failure` says; failures counted."""
        solver: DirectionSolver = self.settings.solver  # type: ignore[assignment]
        answers = solve_batch(solver, problems)
        if self.observe is not None:
            self.observe(problems, answers.protected())
        if np.count_nonzero(answers.status):
            members = np.resize(runs, len(answers))
            answers = self.hand_on(problems, answers, members)
            np.add.at(self.counts["infeasible"], members[answers.status == Status.INFEASIBLE], 1)
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
            chosen = chosen[has_positive_multipliers(constraints.rows(chosen, active))]
            if not chosen.size:
                break
            before = constraints.rows(chosen, active)
            active[chosen] &= ~leaving_constraints(before, raw=self.settings.raw_multipliers)
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
        radius = self.settings.radius
        if self.settings.formulation == "equality" and type(self.settings.solver) not in CLOSED_FORM:
            tangent = tangents(constraints, radius)
        if radius is None:
            return vanishing(tangent, constraints)
        still = np.logical_not(
            tangent.any(axis=1)
        )  # in a ball, where s is as long as the radius or 0, solvers round it themselves
        return still, bool(still.any())
