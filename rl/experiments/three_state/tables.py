"""--compare: CPGRL under other solvers, formulations and drop rules, and CONB with other tolerances, in tables.

What is measured on the way is measured over the updates that all trainings compared have, from the exact averages of
the policy after each of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from time import process_time
from typing import TYPE_CHECKING, Any

import numpy as np

from cpgrl_opt import DirectionBatch, Linearization, ProblemBatch, Status
from cpgrl_opt.arrays import Float, Int
from cpgrl_opt.step import Observer

from ...learners import Learner, LearnerUpdate
from ...training import Training, TrainingRecord
from ..comparison import Comparison, Measure, with_intervals
from ..experiment import CaseRecorder
from ..messages import Outcome
from .curves import LearningCurves, exact_averages

if TYPE_CHECKING:
    from .experiment import ThreeStateExperiment

_TOLERATED = 0.02  # reward per step: by which a policy may violate a threshold and count as feasible
MEASURES = (
    Measure("feasible_from", "feasible from", ".0f"),
    Measure("cumulative_violation", "cumulative violation", ".2f"),
    Measure("common_return", "ρ¹", ".3f"),
    Measure("common_constrained_return", "constrained return", ".3f"),
    Measure("final_return", "final ρ¹", ".4f"),
    Measure("final_constrained_return", "final constrained return", ".4f"),
    Measure("uncertified", "uncertified steps", ".1f"),
)
TOLERANCE_MEASURES = (
    Measure("objective_share", "updates along Δ¹", ".3f"),
    *(Measure(f"a1_s{state}", f"Pr(a₁) in s{index}", ".3f") for state, index in enumerate("₁₂₃", 1)),
    Measure("final_return", "final ρ¹", ".3f"),
    Measure("final_violation", "final violation", ".4f"),
)


@dataclass(eq=False)
class TimedLearner:
    """A learner whose updates are timed, and its solver's own answers counted by status."""

    learner: Learner
    statuses: Int[np.ndarray, "statuses"] = field(init=False, default_factory=lambda: np.zeros(len(Status), np.int64))
    seconds: float = field(init=False, default=0.0)
    has_failed: bool = field(init=False, default=False)
    carried = ("statuses", "seconds", "has_failed")

    def update(
        self, linearization: Linearization, memory: Any = None, observe: Observer | None = None
    ) -> LearnerUpdate:
        """The learner's, its CPU seconds added."""
        begun = process_time()
        update = self.learner.update(linearization, memory, observe)
        self.seconds += process_time() - begun
        return update

    def observe(self, problems: ProblemBatch, answers: DirectionBatch) -> None:
        """Counts answers to problems with an active constraint; those of a fallback, which follow failures, are not."""
        if self.has_failed:
            self.has_failed = False
            return
        self.has_failed = bool((answers.status > Status.INFEASIBLE).any())
        constrained = (problems.bound > -np.inf).any(axis=1)
        np.add.at(self.statuses, answers.status[constrained], 1)


class ComparedRecorder(CaseRecorder):
    """exact: (R, 1 + K, 1 + m), true averages before the first update and after each of the common ones."""

    carried = ("exact", "timed")

    def __init__(self, training: Training, timed: TimedLearner, common: int) -> None:
        self.timed, self.common = timed, common
        first, _ = exact_averages(training.parameters)
        self.exact = np.zeros((len(first), 1 + common, first.shape[1]))
        self.exact[:, 0] = first

    def see(self, record: TrainingRecord) -> Mapping[str, np.ndarray]:
        """Counts updates in which an answer came without certificate."""
        self.last = record.parameters
        if record.episode <= self.common:
            self.exact[:, record.episode] = exact_averages(record.parameters)[0]
        counts = record.update.counts
        return {"uncertified": np.asarray((counts["fallback"] + counts["skipped"]) > 0, dtype=np.int64)}

    def values(self) -> dict[str, np.ndarray]:
        """Once, at the end."""
        return {"exact": self.exact, "last": exact_averages(self.last)[0]}

    def totals(self) -> dict[str, float]:
        """Statuses by name, and the seconds of all updates."""
        statuses = zip(Status, self.timed.statuses.tolist(), strict=True)
        return {**{status.name: number for status, number in statuses}, "update_seconds": self.timed.seconds}


def solver_table(settings: "ThreeStateExperiment") -> Comparison:
    """Of solvers, formulations and drop rules.

    Parameters
    ----------
    settings
        Of the experiment.

    Returns
    -------
    Comparison
        With bootstrap intervals.
    """
    common = settings.common
    return Comparison(
        file="comparison",
        title="CPGRL on the three-state MDP by solver, formulation and drop rule",
        legend=(
            f"Means over {settings.runs} runs with 95 % bootstrap intervals; run i has the same θ₀ and random stream "
            f"in every case. Over the first {common} updates, which every case has: feasible from: updates after "
            f"which max (G − ρ)₊ stays ≤ {_TOLERATED:g} ({common + 1} where it does not); cumulative "
            "violation: Σ max (G − ρ)₊, in reward per step × updates; ρ¹ and constrained return after update "
            f"{common}. Final: after the case's own last update; cases whose solver is not compiled have fewer "
            "updates. All averages are exact. Constrained return: ρ¹ − Σ μ(G − ρ)₊ with the optimum's multipliers μ, "
            "at most the constrained optimum. Uncertified steps: updates of a run in which an answer came without "
            "certificate and active-set took over. Statuses: of the solver's own answers to problems with an active "
            "constraint. ms: CPU of an update of all runs."
        ),
        headings=("formulation", "drop", "solver", "run", "episodes"),
        keys={case.label: (case.formulation, case.drop, case.solver) for case in settings.compared},
        measures=MEASURES,
        measure=partial(measure, settings),
        cells=with_intervals(settings.seed),
        notes=_note,
    )


def measure(
    settings: "ThreeStateExperiment", values: Mapping[str, np.ndarray], outcome: Outcome
) -> Float[np.ndarray, "R measures"]:
    """A row for each run, of MEASURES.

    feasible_from: the updates after which the violation v = max_i (Gⁱ − ρⁱ)₊ stays ≤ tolerance to the common end,
    and common + 1 where it does not; cumulative_violation: Σ v over the common updates; constrained return: the
    exact penalty ρ¹ − Σ μⁱ(Gⁱ − ρⁱ)₊ with the optimum's multipliers, which no policy brings above that optimum.

    Parameters
    ----------
    settings
        Thresholds and optimum.
    values
        Of `ComparedRecorder`.
    outcome
        Counts of the updates.

    Returns
    -------
    (R, measures)
        A row for each run.
    """

    def below(averages: np.ndarray) -> np.ndarray:
        return np.asarray(np.maximum(np.array(settings.thresholds) - averages[..., 1:], 0.0))

    exact, last = values["exact"][:, -1], values["last"][:, -1]
    violation = below(exact).max(axis=2, initial=0.0)
    broken = violation > _TOLERATED
    feasible_from = np.where(broken.any(axis=1), broken.shape[1] - np.argmax(broken[:, ::-1], axis=1), 0)
    returns = [
        column
        for averages in (exact[:, -1], last)
        for column in (averages[:, 0], averages[:, 0] - below(averages) @ settings.optimum.multipliers)
    ]
    columns = [feasible_from, violation[:, 1:].sum(axis=1), *returns, outcome.counts["uncertified"]]
    return np.asarray(np.column_stack(columns), dtype=np.float64)


def tolerance_table(settings: "ThreeStateExperiment") -> Comparison:
    """Of CONB's tolerances.

    Parameters
    ----------
    settings
        Of the experiment.

    Returns
    -------
    Comparison
        With bootstrap intervals.
    """

    def measure(learned: LearningCurves, outcome: Outcome) -> Float[np.ndarray, "R measures"]:
        share = outcome.counts["objective"] / outcome.episode
        violation = learned.violation(np.array(settings.thresholds))[:, -1]
        return np.column_stack([share, learned.policies[:, -1, :, 0], learned.exact[:, -1, 0], violation])

    return Comparison(
        file="tolerances",
        title="CONB on the three-state MDP by its tolerance η",
        legend=(
            f"Means over {settings.runs} runs with 95 % bootstrap intervals, by the last policies' exact averages. "
            "CONB follows Δ¹ where ρ − G > −η in every constraint; as printed, η = 0, that is never. "
            "Violation: max (G − ρ)₊."
        ),
        headings=("tolerance", "run", "episode"),
        keys={case.label: (f"{case.tolerance:g}",) for case in settings.tolerant},
        measures=TOLERANCE_MEASURES,
        measure=measure,
        cells=with_intervals(settings.seed),
    )


def _note(outcome: Outcome) -> dict[str, str]:
    statuses = ((status.name, int(outcome.totals[status.name])) for status in Status)
    return {
        "updates": str(outcome.episode),
        "statuses": ", ".join(f"{number} {name}" for name, number in statuses if number),
        "ms": f"{1e3 * outcome.totals['update_seconds'] / outcome.episode:.2f}",
    }
