"""The paper's first experiment (§3): CPGRL, CONB and SUM on the three-state MDP, beside exact averages.

--compare trains CPGRL under other solvers, formulations and drop rules too. Run i of every training has the same θ₀ and
the same random stream, so that trainings differ by their subproblems' answers. One of them ends after `episodes`
updates, or after COMPARED_EPISODES where its solver is not compiled.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any

import numpy as np

from cpgrl_opt import FORMULATIONS
from cpgrl_opt.solvers import SOLVERS, compile_kernels, is_usable, solver_named
from cpgrl_opt.step import DROP_RULES, Observer
from envs.tabular import ConstrainedOptimum

from ...estimators import GPOMDP
from ...learners import CPGRL, ConstraintSwitching, Learner, WeightedSum
from ...policies import SoftmaxTable
from ...training import Training, TrainingRecord, uniform_parameters
from .. import solver_cases
from ..bootstrap import spread
from ..claims import Claim
from ..comparison import Comparison
from ..experiment import CaseRecorder, Experiment, Figures, Results, TrainingCase, option
from .claims import STATEMENTS, Evidence
from .curves import MDP, AveragesRecorder, LearningCurves, exact_averages
from .figures import averages_figure, policies_figure
from .tables import ComparedRecorder, TimedLearner, solver_table, tolerance_table

METHODS = ("cpgrl", "conb", "sum", "conb-tolerant")
TOLERANCES = (0.0, 0.003, 0.005, 0.006, 0.01)  # η of CONB compared: from none to where it follows Δ¹ in a third
COMPARED_EPISODES = 500  # updates of a training compared whose solver is not compiled
SOLVERS_COMPARED = ("rosen", "active-set", "rosen-drop", "osqp", "daqp")


@dataclass(frozen=True, kw_only=True)
class ThreeStateCase(TrainingCase):
    """CPGRL, CONB or SUM, or "" for CPGRL compared; drop: "" where the formulation has no drop rule."""

    method: str = ""
    tolerance: float = 0.0
    formulation: str = ""
    drop: str = ""


@dataclass(frozen=True, kw_only=True)
class ThreeStateExperiment(Experiment):
    """The paper's first experiment; beside it CONB with a tolerance, `conb-tolerant`, which is ours. See `Experiment`.

    thresholds G², G³, G⁴, and the tolerance η of conb-tolerant: reward per step. compare_solvers: names (none: those of
    SOLVERS_COMPARED that can be used; "all" alone: all that can be used).
    """

    name = "three-state"
    about = "CPGRL, CONB and SUM on the three-state MDP: §3 of the paper, Fig. 4 and 5."
    key = "method"
    recorded = MappingProxyType(
        {kind: [f"{kind}_{channel}" for channel in range(1, 5)] for kind in ("estimated", "exact")}
    )
    files = (
        "fig4.png", "fig4.svg", "fig5.png", "fig5.svg", "comparison.csv", "comparison.md",
        "tolerances.csv", "tolerances.md",
    )  # fmt: skip
    splits = False  # an update of all runs in lockstep costs little more than one of half of them

    steps: int = option(100, "Environment steps of an episode.")
    thresholds: tuple[float, ...] = (0.0, 0.0, 0.0)
    tolerance: float = 0.006
    compare: bool = option(
        False, "Train CPGRL under other solvers, formulations and drop rules too, and CONB with other tolerances."
    )
    compare_solvers: Sequence[str] = option((), "Of --compare; five if empty; or `all`.")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.estimator()
        self.learner(self._conb(self.tolerance))
        for name in {*self.compare_solvers} - {"all"}:
            solver_named(name)

    def estimator(self) -> GPOMDP:
        """Eq. 3 and 4."""
        return GPOMDP(**self.estimator_settings())

    def learner(self, case: ThreeStateCase) -> Learner:
        """CPGRL, CONB or SUM."""
        if case.method == "conb":
            return ConstraintSwitching(self.thresholds, step_size=self.step_size, tolerance=case.tolerance)
        if case.method == "sum":
            return WeightedSum(step_size=self.step_size)
        rule = {"drop": case.drop} if case.drop else {}
        return CPGRL(self.step(solver=case.solver, formulation=case.formulation, **rule), self.thresholds)

    def cases(self) -> list[ThreeStateCase]:
        """The methods, then what is compared."""
        cpgrl = self._of("cpgrl", solver=self.solver, formulation=self.formulation, by_cpgrl=True, kept=True)
        own = [cpgrl, self._of("conb"), self._of("sum"), self._conb(self.tolerance)]
        return [*own, *(case for case in self.tolerant if case not in own), *self.compared] if self.compare else own

    def _of(self, method: str, label: str = "", **more: Any) -> ThreeStateCase:
        return ThreeStateCase(
            label=label or method, method=method, episodes=self.episodes, every=self.record_every, from_start=True,
            **more,
        )  # fmt: skip

    def _conb(self, tolerance: float) -> ThreeStateCase:
        """CONB with a tolerance other than 0; the settings' own has a name, and is in `learning.csv`."""
        if tolerance == self.tolerance:
            return self._of("conb", "conb-tolerant", tolerance=tolerance)
        return self._of("conb", f"conb, tolerance {tolerance:g}", tolerance=tolerance, in_learning=False)

    @property
    def tolerant(self) -> list[ThreeStateCase]:
        """CONB with every tolerance compared, none first."""
        others = sorted({*TOLERANCES, self.tolerance} - {0.0})
        return [self._of("conb"), *map(self._conb, others)]

    @cached_property
    def compared(self) -> list[ThreeStateCase]:
        """Every solver under every formulation that it takes; every drop rule under the first that takes equalities."""
        compared = []
        for formulation in FORMULATIONS:
            takers = [name for name in self.solvers_compared() if formulation in solver_cases.cases(solver_named(name))]
            for name in takers:
                drops: Sequence[str] = ("stationary",) if formulation == "equality" else ("",)
                if formulation == "equality" and name == takers[0]:
                    drops = DROP_RULES
                compared += [self._compared(formulation, drop, name) for drop in drops]
        return compared

    def _compared(self, formulation: str, drop: str, solver: str) -> ThreeStateCase:
        is_compiled = getattr(solver_named(solver), "package", None) == "numba"
        episodes = self.episodes if is_compiled else min(self.episodes, COMPARED_EPISODES)
        return ThreeStateCase(
            label=", ".join(filter(None, (formulation, drop, solver))), formulation=formulation, drop=drop,
            solver=solver, episodes=episodes, every=episodes, in_learning=False, rank=2 - (not is_compiled),
        )  # fmt: skip

    def solvers_compared(self) -> list[str]:
        """Their names; those that can be used, where they were not named."""
        names = SOLVERS if list(self.compare_solvers) == ["all"] else self.compare_solvers or SOLVERS_COMPARED
        return [name for name in names if name in self.compare_solvers or is_usable(solver_named(name))]

    @property
    def common(self) -> int:
        """Updates that every training compared has."""
        return min(case.episodes for case in self.compared)

    @staticmethod
    def measure(record: TrainingRecord) -> dict[str, np.ndarray]:
        """ρ̂, and the true averages of the policy after the update."""
        return {"value": record.estimate.values, "exact": exact_averages(record.parameters)[0]}

    def begin(
        self, case: ThreeStateCase, runs: Sequence[int], observe: Observer | None = None
    ) -> tuple[Training, CaseRecorder]:
        """From θ₀ ~ U[0, 1]⁹ of each run."""
        learner, timed = self.learner(case), None
        if not case.method:
            learner = timed = TimedLearner(learner)
            observe = timed.observe
        training = Training(
            MDP, SoftmaxTable(MDP.states, MDP.actions), self.estimator(), learner, episodes=case.episodes, runs=runs,
            seed=self.seed, initial=uniform_parameters(MDP.states * MDP.actions), observe=observe,
        )  # fmt: skip
        return training, AveragesRecorder(training) if timed is None else ComparedRecorder(training, timed, self.common)

    def prepare(self, case: ThreeStateCase) -> None:
        """CPGRL solves only a few direction problems that are hard, the other methods none."""
        if case.method in ("", "cpgrl"):
            compile_kernels(thorough=not case.method)

    def curves(self, case: ThreeStateCase, episodes: np.ndarray, values: Mapping[str, np.ndarray]) -> Any:
        """LearningCurves of a method."""
        return LearningCurves(episodes, **values) if case.method else values

    @cached_property
    def optimum(self) -> ConstrainedOptimum:
        """The exact one."""
        return MDP.constrained_optimum(self.thresholds)

    def claims(self, results: Results) -> list[Claim]:
        """In the paper's order; then what they say of CONB, of CONB with a tolerance."""
        printed, tolerant = (self._evidence(results, conb) for conb in ("conb", "conb-tolerant"))
        about = f"CONB with a tolerance, η = {self.tolerance:g}"
        again = [replace(own.judge(tolerant), id=f"{own.id}-tolerant", about=about) for own in STATEMENTS if own.about]
        return STATEMENTS.judge(printed) + again

    def _evidence(self, results: Results, conb: str) -> Evidence:
        """What the claims are judged by; conb: the training that stands for it."""
        share = results.outcomes[conb].counted()["objective"] / (self.runs * self.episodes)
        learned = zip(("cpgrl", "conb", "sum"), ("cpgrl", conb, "sum"), strict=True)
        curves = {method: results.curves[label] for method, label in learned}
        return Evidence(curves, self.optimum.values, np.array(self.thresholds), share)

    def figures(self, results: Results) -> Figures:
        """The paper's Fig. 4 and 5."""
        learned = {method: results.curves[method] for method in METHODS}
        return {
            "fig4": partial(averages_figure, learned, self.optimum.values, np.array(self.thresholds)),
            "fig5": partial(policies_figure, learned, MDP),
        }

    def comparisons(self) -> list[Comparison]:
        """Of solvers, formulations and drop rules, and of CONB's tolerances, if asked for."""
        return [solver_table(self), tolerance_table(self)] if self.compare else []

    def summary(self, results: Results) -> dict[str, Any]:  # noqa: ARG002
        """The optimum."""
        parts = ("values", "policy", "multipliers")
        return {"optimum": {name: getattr(self.optimum, name).tolist() for name in parts}}

    def summary_of(self, case: ThreeStateCase, results: Results) -> dict[str, Any]:
        """Where a method ended."""
        if not case.method:
            return {}
        learned = results.curves[case.label]
        last = learned.exact[:, -1]
        final = {"mean": last.mean(axis=0), "standard_deviation": spread(last)}
        final["policy"] = learned.policies[:, -1].mean(axis=0)
        return {"final": {name: value.tolist() for name, value in final.items()}}
