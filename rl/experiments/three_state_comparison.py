"""`--compare`: the three-state training under each solver, formulation and drop rule, on common random numbers.

Run i of every case has the same θ₀ and the same random stream, so that cases differ by their subproblems' answers.
A case ends after `episodes` updates, or after `slow_episodes` where its solver is not compiled. What is measured on
the way is measured over the updates that every case has, from the exact averages of the policy after each of them.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter, process_time
from typing import Any

import numpy as np

from cpgrl_opt import FORMULATIONS, DirectionBatch, Linearization, ProblemBatch, Status
from cpgrl_opt.arrays import Float, Int
from cpgrl_opt.solvers import SOLVERS, compile_kernels, is_usable, solver_named
from cpgrl_opt.step import DROP_RULES, Observer
from cpgrl_opt.validation import require_count
from envs import ThreeStateMDP

from ..learners import CPGRL, Learner, LearnerUpdate
from ..policies import SoftmaxTable
from ..training import train, uniform_parameters
from .solver_cases import cases, require_installed
from .three_state import ThreeStateSettings
from .workers import run_tasks

SOLVERS_COMPARED = ("rosen", "active-set", "rosen-drop", "osqp", "daqp")
_TICK = 0.2  # s between signs of life


@dataclass(frozen=True, kw_only=True)
class ComparisonSettings:
    """What is compared with what.

    training: runs, episodes, rates and seed of every case; solvers: names (None: those of SOLVERS_COMPARED that can
    be used; "all" alone: all that can be used); formulations: names. slow_episodes: updates of a case whose solver is
    not compiled. tolerance: by which a policy may violate a threshold and count as feasible, in reward per step.
    Raises ValueError for unknown names and for solvers none of which takes any of the formulations.
    """

    training: ThreeStateSettings
    solvers: Sequence[str] | None = None
    formulations: Sequence[str] = tuple(FORMULATIONS)
    slow_episodes: int = 500
    tolerance: float = 0.02

    def __post_init__(self) -> None:
        require_count("slow_episodes", self.slow_episodes)
        for name in self.formulations:
            if name not in FORMULATIONS:
                raise ValueError(f"formulation should be one of {', '.join(FORMULATIONS)}; found {name!r}")
        for name in self.names():
            solver_named(name)
        if not self.cases():
            raise ValueError("a solver should take one of the formulations compared; found none that does")

    def names(self) -> list[str]:
        """The solvers compared."""
        if self.solvers and list(self.solvers) != ["all"]:
            return list(self.solvers)
        return [name for name in (SOLVERS if self.solvers else SOLVERS_COMPARED) if is_usable(solver_named(name))]

    def cases(self) -> "list[Case]":
        """Every solver under every formulation that it takes; every drop rule under the first that takes equalities."""
        found = []
        for formulation in self.formulations:
            takers = [name for name in self.names() if formulation in cases(solver_named(name))]
            for name in takers:
                is_first = formulation == "equality" and name == takers[0]
                drops = DROP_RULES if is_first else ("stationary",) if formulation == "equality" else ("",)
                found += [Case(formulation, drop, name, self.episodes(name)) for drop in drops]
        return found

    def episodes(self, solver: str) -> int:
        """Updates of a case with this solver."""
        most = self.training.episodes
        return most if is_compiled(solver) else min(most, self.slow_episodes)

    @property
    def updates(self) -> int:
        """Of all cases together."""
        return sum(case.episodes for case in self.cases())

    @property
    def common(self) -> int:
        """Updates that every case has."""
        return min(case.episodes for case in self.cases())


def is_compiled(solver: str) -> bool:
    """Whether a batch of problems is one compiled call."""
    return getattr(solver_named(solver), "package", None) == "numba"


@dataclass(frozen=True)
class Case:
    """One training; drop: "" where the formulation has no drop rule."""

    formulation: str
    drop: str
    solver: str
    episodes: int


@dataclass(frozen=True, eq=False)
class CaseOutcome:
    """What a case did, by run.

    exact: (R, 1 + K, 1 + m), true averages before the first update and after each of the common ones; last: (R, 1 + m)
    at the case's end; uncertified: (R,), updates in which an answer of the solver came without certificate (active-set
    took over, or θ stayed). statuses: the solver's answers by the name of their Status; update_seconds: CPU per
    update of all runs, without the estimate; seconds: wall time of the training.
    """

    case: Case
    exact: Float[np.ndarray, "R moments channels"]
    last: Float[np.ndarray, "R channels"]
    uncertified: Int[np.ndarray, "R"]
    statuses: Mapping[str, int]
    update_seconds: float
    seconds: float


@dataclass(frozen=True)
class Progress:
    """A sign of life: so many updates of all cases together."""

    label: str
    episode: int


@dataclass(eq=False)
class _Timed:
    """A learner whose updates are timed, and its solver's own answers counted by status."""

    learner: Learner
    statuses: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    _has_failed: bool = False

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
        if self._has_failed:
            self._has_failed = False
            return
        self._has_failed = bool((answers.status > Status.INFEASIBLE).any())
        constrained = (problems.bound > -np.inf).any(axis=1)
        for status, number in zip(*np.unique(answers.status[constrained], return_counts=True), strict=True):
            self.statuses[Status(int(status)).name] += int(number)


def compare_three_state(
    settings: ComparisonSettings, *, processes: int = 1, listen: Callable[[Progress], None] | None = None
) -> list[CaseOutcome]:
    """Every case, in the settings' order, shared out over processes, on whose number nothing but time depends."""
    for case in settings.cases():
        require_installed(solver_named(case.solver))
    # The longest first, which are not compiled, so that no process waits long for another at the end.
    order = sorted(settings.cases(), key=lambda case: is_compiled(case.solver))
    done = 0

    def heard(updates: int) -> None:
        nonlocal done
        done += updates
        if listen is not None:
            listen(Progress("comparison", done))

    outcomes = run_tasks(train_case, [(settings, case) for case in order], heard, processes=processes)
    by_case = {outcome.case: outcome for outcome in outcomes}
    return [by_case[case] for case in settings.cases()]


def train_case(item: tuple[ComparisonSettings, Case], report: Callable[[int], None]) -> CaseOutcome:
    """One case, all runs in lockstep; reports how many updates were done since it last did."""
    settings, case = item
    training, mdp = settings.training, ThreeStateMDP()
    common = settings.common  # which asks every solver what it takes: once
    compile_kernels()
    table, initial = SoftmaxTable(mdp.states, mdp.actions), uniform_parameters(mdp.states * mdp.actions)
    step = replace(
        training.step(),
        solver=solver_named(case.solver),
        formulation=case.formulation,
        drop=case.drop or training.step().drop,
    )
    exact, uncertified, reported = [], np.zeros(training.runs, np.int64), 0
    begun = ticked = perf_counter()
    first: list[np.ndarray] = []

    def draw(rng: np.random.Generator) -> np.ndarray:
        first.append(initial(rng))
        return first[-1]

    timed = _Timed(CPGRL(step, training.thresholds))
    records = train(
        mdp, table, training.estimator(), timed,
        episodes=case.episodes, runs=training.runs, seed=training.seed, initial=draw,
        observe=timed.observe,
    )  # fmt: skip
    exact.append(mdp.average_rewards(table.probabilities(np.array(first))))
    for record in records:
        counts = record.update.counts
        uncertified += (counts["fallback"] + counts["skipped"]) > 0
        if record.episode <= common:
            exact.append(mdp.average_rewards(table.probabilities(record.parameters)))
        if perf_counter() - ticked > _TICK or record.episode == case.episodes:
            report(record.episode - reported)
            ticked, reported = perf_counter(), record.episode
    last = mdp.average_rewards(table.probabilities(record.parameters))
    return CaseOutcome(
        case, np.stack(exact, axis=1), last, uncertified, dict(timed.statuses),
        timed.seconds / case.episodes, perf_counter() - begun,
    )  # fmt: skip
