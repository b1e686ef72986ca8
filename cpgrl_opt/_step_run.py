"""One call of a step where M = I: formulation → solver → safeguards → change of θ."""

from dataclasses import replace
from typing import Any

import numpy as np

from ._violation import is_missed
from .arrays import Bool, Float, Int
from .direction import DirectionBatch, DirectionError, Status
from .drop_rule import choose_leaving, has_positive_multipliers, tangents, vanish
from .formulation import FORMULATIONS, ActiveConstraints
from .problem import DirectionProblem, ProblemBatch
from .recovery import recover
from .scaling import lengths, resolve_overflow, unit_rows
from .solvers import ActiveSet, DirectionSolver, Rosen, solve_batch, tolerance_of
from .solvers.infeasibility import infeasible_direction
from .step_result import COUNTS, StepResult
from .step_settings import CLOSED_FORM, StepSettings
from .validation import is_finite

Moves = list[DirectionBatch]  # the tangents s, and the restorations v unless these are inside; with residuals


class StepRun:
    """One call of a step: carries the counts while the pieces below do the work.

    given: the gradients as they were before a metric's coordinates, None where it has none.
    """

    def __init__(self, settings: StepSettings, observe: Any, runs: int, given: np.ndarray | None = None) -> None:
        self.settings, self.observe, self.runs, self.given = settings, observe, runs, given
        self.formulation = FORMULATIONS[settings.formulation]
        self.counts = dict(zip(COUNTS, np.zeros((len(COUNTS), runs), np.int64), strict=True))

    def step(self, gradients: np.ndarray, slack: np.ndarray, active: np.ndarray) -> StepResult:
        """Of B runs: (B, 1 + m, n), (B, m), (B, m)."""
        n = gradients.shape[2]
        constraints = self.limit(self.admit(gradients, slack, active), slack, n)
        moves = self.solve(constraints, np.arange(self.runs))
        moves, still = self.settle(constraints, moves)
        multipliers = np.where(constraints.active, constraints.original(moves[0].multipliers), 0.0)
        change = self.change(moves, n)
        skipped = self.counts["skipped"] > 0  # a failed solver's zeros are no optimum
        for answer in (change, still, multipliers):
            answer[skipped] = 0
        if self.settings.radius is not None and len(moves) > 1:
            longest = self.settings.step_size * self.settings.radius  # type: ignore[operator]
            self.counts["long"] += lengths(change) > longest * (1.0 + tolerance_of(self.settings.solver))
        with np.errstate(over="ignore", invalid="ignore"):  # in the order of `direct_step.predict`
            terms = np.concatenate([slack[:, :, None], gradients[:, 1:] * change[:, None]], axis=2)
            predicted = np.add.accumulate(terms, axis=2)[:, :, -1].copy()
        predicted = resolve_overflow(predicted, slack, gradients[:, 1:], change)
        active = multipliers > 0.0 if self.formulation.takes_all else active
        residuals = np.max([each.residuals for each in moves], axis=0)  # type: ignore[arg-type]
        return StepResult(change, active, still, self.counts, multipliers, residuals, predicted)

    def admit(self, gradients: np.ndarray, slack: np.ndarray, active: np.ndarray) -> ActiveConstraints:
        """𝒜 without the constraints whose gradient is 0, and t = −min(slack, 0); with its ridge, if it has one."""
        kept = active & gradients[:, 1:].any(axis=2)
        self.counts["flat"] += np.count_nonzero(active & ~kept, axis=1)
        constraints = ActiveConstraints(gradients, np.maximum(-slack, 0.0), kept, np.zeros(slack.shape, np.int64))
        if self.settings.ridge > 0:
            self.counts["softened"] += kept.any(axis=1)
            return constraints.soften(self.settings.ridge)
        constraints = constraints.balance()
        if self.given is not None:
            self.given = np.ldexp(self.given[:, 1:], -constraints.exponents[:, :, None])
        return constraints

    def limit(self, constraints: ActiveConstraints, slack: np.ndarray, n: int) -> ActiveConstraints:
        """t within `max_restoration`; αₑ t − κ max(slack, 0) in its place where all constraints are in."""
        settings, target = self.settings, constraints.target
        if settings.max_restoration < np.inf:
            target = target * self.cap(constraints, n)[:, None]
        if self.formulation.takes_all:
            room = np.ldexp(float(settings.slack_fraction) * np.maximum(slack, 0.0), -constraints.exponents)
            target = float(settings.restoration_rate) * target - room
        return replace(constraints, target=target)

    def cap(self, constraints: ActiveConstraints, n: int) -> Float[np.ndarray, "B"]:
        """The factor with αₑ‖J⁺t‖, and with a restoration inside αₑ‖v‖, v of `cone`, ≤ max_restoration."""
        if self.formulation.takes_all:
            constraints = replace(constraints, active=constraints.active & (constraints.target > 0.0))
        solvers: dict[str, DirectionSolver] = {"equality": Rosen(), "cone": ActiveSet()}
        factor = np.ones(self.runs)
        for name in list(solvers) if self.formulation.restores_inside else ["equality"]:
            problems = FORMULATIONS[name].problems(constraints, 0.0)[self.runs :]
            found = self.hand_on(problems, solve_batch(solvers[name], problems), np.arange(self.runs))
            factor = np.minimum(factor, self.shorten(found.value, n))
        return factor

    def shorten(self, moves: Float[np.ndarray, "B any"], n: int) -> Float[np.ndarray, "B"]:
        """The factor ≤ 1 with αₑ‖v‖ ≤ max_restoration in the n parameters; what a ridge adds to them moves no θ."""
        length = self.settings.restoration_rate * lengths(np.where(np.arange(moves.shape[1]) < n, moves, 0.0))
        too_long = length > self.settings.max_restoration
        self.counts["capped"] |= too_long
        return np.where(too_long, self.settings.max_restoration / np.where(too_long, length, 1.0), 1.0)

    def solve(self, constraints: ActiveConstraints, runs: Int[np.ndarray, "chosen"]) -> Moves:
        """Tangents, in the ball where there is one, and restorations: each the shortest move that restores."""
        settings, count = self.settings, len(runs)
        inside = 1.0 if self.formulation.takes_all else settings.restoration_rate  # which `limit` has taken in
        problems = self.formulation.problems(constraints, inside / settings.step_size if settings.step_size else 0.0)
        is_inside = self.formulation.restores_inside
        if settings.radius is None:
            answers = self.solve_certified(problems, runs)
            return [answers] if is_inside else [answers[:count], answers[count:]]
        answers = self.solve_certified(problems[:count].in_geometry(None, settings.radius), runs)
        return [answers] if is_inside else [answers, self.solve_certified(problems[count:], runs)]

    def solve_certified(self, problems: ProblemBatch, runs: Int[np.ndarray, "chosen"]) -> DirectionBatch:
        """Answers that are OPTIMAL or INFEASIBLE, the rest handed on as `on_failure` says; failures counted."""
        solver: DirectionSolver = self.settings.solver  # type: ignore[assignment]
        answers = solve_batch(solver, problems)
        if self.observe is not None:
            self.observe(problems, answers.protect())
        members = np.resize(runs, len(answers))
        answers = self.hand_on(problems, answers, members)
        if self.given is not None and self.settings.ridge == 0:
            answers = self.contradict(problems, answers, members)
        infeasible = np.flatnonzero(answers.status == Status.INFEASIBLE)
        np.add.at(self.counts["infeasible"], members[infeasible], 1)
        if self.formulation.takes_all and infeasible.size:
            answers = answers.copy()
            for k in infeasible.tolist():
                recovered = recover(problems[k], answers.value[k])
                if recovered is not None:  # the proof stays what it is
                    answers.value[k] = recovered
        residuals = np.full((len(answers), 4), np.nan) if answers.residuals is None else answers.residuals.copy()
        residuals[infeasible] = np.nan  # whatever the answer was certified as before it was found to be so
        return replace(answers, residuals=residuals)

    def contradict(self, problems: ProblemBatch, answers: DirectionBatch, runs: np.ndarray) -> DirectionBatch:
        """INFEASIBLE where rows and bounds are so by themselves, which a metric may hide; d violates as little in M.

        And skipped where they are so in the coordinates alone of a metric that is known by its products.
        """
        slack = np.vecdot(problems.jacobian, answers.value[:, None]) - problems.bound
        answers = answers.copy()
        is_rough = callable(self.settings.metric) and problems.radius is None
        for k in np.flatnonzero(answers.status <= (Status.INFEASIBLE if is_rough else Status.OPTIMAL)).tolist():
            J, bound, equality = self.given[runs[k]], problems.bound[k], problems.equality[k]  # type: ignore[index]
            unit = unit_rows(J)
            is_doubted = answers.status[k] == Status.INFEASIBLE
            if is_doubted or is_missed(unit.per_length(bound), unit.per_length(slack[k]), equality):
                proof = infeasible_direction(DirectionProblem.trusted(np.zeros(J.shape[1]), J, bound, equality))
                if proof is not None:
                    answers.status[k], answers.multipliers[k] = Status.INFEASIBLE, proof.multipliers
                elif is_doubted and self.settings.on_failure == "raise":
                    raise DirectionError(str(Status.UNCERTIFIED))
                elif is_doubted:
                    answers.status[k], self.counts["skipped"][runs[k]] = Status.UNCERTIFIED, 1
        return answers

    def hand_on(self, problems: ProblemBatch, answers: DirectionBatch, runs: np.ndarray) -> DirectionBatch:
        """The failures handed on."""
        failed = answers.status > Status.INFEASIBLE
        if failed.any() and self.settings.on_failure == "raise":
            raise DirectionError(str(Status(int(answers.status[failed][0]))))
        if failed.any() and self.settings.on_failure == "fallback":
            np.add.at(self.counts["fallback"], runs[failed], 1)
            again = ActiveSet().solve_batch(problems.select(failed))
            answers = answers.replace_where(failed, again)
            if self.observe is not None:
                self.observe(problems.select(failed), again.protect())
        self.counts["skipped"][runs[answers.status > Status.INFEASIBLE]] = 1
        return answers

    def settle(self, constraints: ActiveConstraints, moves: Moves) -> tuple[Moves, Bool[np.ndarray, "B"]]:
        """s and v after the drop rule, and whether a run is stationary."""
        still = self.at_rest(moves[0].value, constraints)
        if self.formulation.restores_inside:
            still &= self.counts["infeasible"] == 0  # where nothing meets the constraints, 0 is no KKT point
        if self.settings.formulation != "equality" or not (still.any() or self.settings.drop == "always"):
            return moves, still
        if self.settings.drop != "never":
            return self.drop(constraints, moves, still)
        still[still] = ~has_positive_multipliers(constraints.rows(still))
        return moves, still

    def at_rest(self, tangent: np.ndarray, constraints: ActiveConstraints) -> Bool[np.ndarray, "B"]:
        """PΔ¹ = 0 up to rounding; with `equality` whatever the solver's tolerance."""
        radius = self.settings.radius
        if self.settings.formulation == "equality" and type(self.settings.solver) not in CLOSED_FORM:
            tangent = tangents(constraints, radius)
        # In a ball, where s is as long as the radius or 0, solvers round it themselves.
        return vanish(tangent, constraints) if radius is None else (tangent == 0.0).all(axis=1)

    def drop(self, constraints: ActiveConstraints, moves: Moves, still: np.ndarray) -> tuple[Moves, np.ndarray]:
        """𝒜 ← 𝒜 without the largest λ, until some λ ≤ 0 exists; P and d are built anew. See `drop_rule`. §2.3.

        Returns s, v, and whether PΔ¹ = 0 at the end of it.
        """
        moves, active = [each.copy() for each in moves], constraints.active.copy()  # an observer may have kept them
        always = self.settings.drop == "always"
        open_ = active.any(axis=1) if always else still
        for _ in range(active.shape[1]):
            chosen = np.flatnonzero(open_ & (self.counts["skipped"] == 0))
            chosen = chosen[has_positive_multipliers(constraints.rows(chosen, active))]
            if not chosen.size:
                break
            before = constraints.rows(chosen, active)
            active[chosen] &= ~choose_leaving(before, raw=self.settings.raw_multipliers)
            fewer = constraints.rows(chosen, active)
            self.counts["dropped"][chosen] += np.count_nonzero(before.active & ~fewer.active, axis=1)
            self.counts["infeasible"][chosen] = 0  # the problems are others now
            again = self.solve(fewer, chosen)
            for kept, new in zip(moves, again, strict=True):
                for name in ("value", "multipliers", "residuals"):
                    getattr(kept, name)[chosen] = getattr(new, name)
            still[chosen] = self.at_rest(again[0].value, fewer)
            open_ = np.isin(np.arange(len(active)), chosen) & (still | always)
        return moves, still

    def change(self, moves: Moves, n: int) -> Float[np.ndarray, "B n"]:
        """α₁ s + αₑ v of the n parameters."""
        settings = self.settings
        with np.errstate(over="ignore", invalid="ignore"):  # found below
            change = settings.step_size * moves[0].value
            for restoration in [each.value for each in moves[1:]]:
                if settings.max_restoration < np.inf and settings.formulation == "cone":  # J v ≥ t: as long as t is
                    restoration = restoration * self.shorten(restoration, n)[:, None]
                change += settings.restoration_rate * restoration
        if not is_finite(change):
            rates = f"step_size {settings.step_size:g} and restoration_rate {settings.restoration_rate:g}"
            raise FloatingPointError(f"the change of θ should be finite; found inf, with {rates}: lower the rates")
        return np.ascontiguousarray(change[:, :n])
