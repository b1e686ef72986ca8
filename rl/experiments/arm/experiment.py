"""The paper's second experiment (§4): CPGRL on the two-link arm, with and without constraints."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from cpgrl_opt import FORMULATIONS, ConstrainedStep
from cpgrl_opt.step import Observer
from cpgrl_opt.validation import require_member
from envs import TwoLinkArm

from ...estimators import GPOMDP, GradientEstimator, KondaActorCritic
from ...learners import CPGRL, GradientWithRestoration, Learner, WeightedSum
from ...policies import NormalizedGaussianNetwork
from ...training import Training
from ..claims import Claim
from ..comparison import Comparison
from ..experiment import CaseRecorder, Experiment, Figures, Results, TrainingCase, option
from .animation import write_animation
from .claims import STATEMENTS, ArmEvidence
from .conditions import CONDITIONS, PAPER
from .curves import ARM, OUTCOMES, TouchCurves, TouchRecorder
from .figures import touches_figure, workspace_figure
from .paths import arm_path, count_touches, starts_beside_aversive, typical_path, typical_run
from .tables import formulation_table

ESTIMATORS = ("konda", "gpomdp")
MAX_CHANGE = 10.0  # of a component of θ in an update: a training that goes further has diverged, and says so
# By what an episode takes: without a square to reach, or with time to wait, episodes are long.
_LONGEST_FIRST = ("b", "a", "c-episode", "c", "c-no-projection", "c-feasible")
_BASIS = (5, 8)  # 40 basis functions (§4.1), 8 of them along φ₂
_ANIMATED = 4  # episodes of the animation, from as many directions around the star
_DRAWING = 1 << 32  # spawn key of what is drawn for figures: beyond that of any run

# --compare: (b) and (c) under each formulation, by a solver that takes it.
COMPARED_CONDITIONS = ("b", "c")
COMPARED_STEPS = (
    ("rosen", "equality"),
    ("active-set", "cone"),
    ("active-set", "restoring"),
    ("active-set", "linearized"),
)


@dataclass(frozen=True, kw_only=True)
class ArmCase(TrainingCase):
    """A condition under a solver and a formulation."""

    condition: str
    formulation: str


@dataclass(frozen=True, kw_only=True)
class ArmExperiment(Experiment):
    """The paper's second experiment; rates are those of §3.1, "the same meta-parameters", the rest ours where it is
    silent. See `Experiment`.

    estimator: one of ESTIMATORS; conditions: some of CONDITIONS, put into their order; critic_rate α_w. Safeguards,
    ours, without which the printed update diverges on the arm: ridge ε in the squared unit of a gradient,
    max_restoration ‖αₑ d‖ in the unit of θ; drop: see `ConstrainedStep`. gradient: eq. 5 and 3 as printed, the mean
    over each episode's own steps.
    """

    name = "arm"
    about = "The two-link arm with and without constraints: §4 of the paper, Fig. 6 and 7."
    key = "condition"
    recorded = MappingProxyType({"touches": OUTCOMES, "violation": ["violation"], "length": ["length"]})
    files = (
        "fig6.png", "fig6.svg", "fig7.png", "fig7.svg", "fig7.gif", "fig7-beside.png", "fig7-beside.svg",
        "compare.csv", "compare.md",
    )  # fmt: skip

    steps: int = 1000
    estimator: str = option("konda", "Of the gradients: konda, gpomdp.")
    conditions: Sequence[str] = option(
        tuple(CONDITIONS), "a, b, c of the paper; c-episode, c-feasible, c-no-projection beside them."
    )
    critic_rate: float = 0.02
    ridge: float = 1e-4
    max_restoration: float = 0.1
    drop: str = "never"
    compare: bool = option(False, "Train (b) and (c) under every formulation too: compare.csv, compare.md.")

    def __post_init__(self) -> None:
        require_member("estimator", self.estimator, ESTIMATORS)
        for name in self.conditions or ("",):
            require_member("condition", name, tuple(CONDITIONS))
        object.__setattr__(self, "conditions", tuple(name for name in CONDITIONS if name in self.conditions))
        super().__post_init__()
        self.gradient_estimator("a")

    def step(self, **changes: Any) -> ConstrainedStep:
        """The step with its safeguards; "linearized" goes without the ridge, which it does not take."""
        is_linearized = changes.get("formulation", self.formulation) == "linearized"
        safeguards = {"ridge": 0.0 if is_linearized else self.ridge, "max_restoration": self.max_restoration}
        return super().step(drop=self.drop, **safeguards, **changes)

    def gradient_estimator(self, condition: str) -> GradientEstimator:
        """Eq. 5, or eq. 3, with eq. 4."""
        shared = {**self.estimator_settings(), "average": CONDITIONS[condition].average}
        if self.estimator == "gpomdp":
            return GPOMDP(**shared)
        return KondaActorCritic(**shared, critic_rate=self.critic_rate)

    def learner(self, case: ArmCase) -> Learner:
        """Plain policy gradient of r¹, CPGRL, or gradient plus restoration.

        Without P "restoring" and "linearized" have no restoration of their own; that of "cone" stands in.
        """
        condition = CONDITIONS[case.condition]
        if condition.thresholds is None:
            return WeightedSum([1, 0, 0], step_size=self.step_size)
        step = self.step(solver=case.solver, formulation=case.formulation)
        if condition.projected:
            return CPGRL(step, condition.thresholds)
        if FORMULATIONS[step.formulation].restores_inside:
            step = replace(step, formulation="cone")
        return GradientWithRestoration(step, condition.thresholds)

    def cases(self) -> list[ArmCase]:
        """The conditions, then what is compared with them; the settings' own step is not trained twice."""
        own = [self._case(name, self.solver, self.formulation) for name in self.conditions]
        return own + [case for case in self.compared() if case not in own]

    def compared(self) -> list[ArmCase]:
        """The cases of the comparison, those that are a condition's own among them."""
        if not self.compare:
            return []
        return [self._case(condition, *step) for condition in COMPARED_CONDITIONS for step in COMPARED_STEPS]

    def _case(self, name: str, solver: str, formulation: str) -> ArmCase:
        own = name in self.conditions and (solver, formulation) == (self.solver, self.formulation)
        condition = CONDITIONS[name]
        return ArmCase(
            label=name if own else f"{name}, {formulation}", condition=name, solver=solver, formulation=formulation,
            episodes=self.episodes, every=self.record_every, in_learning=own, kept=condition.thresholds is not None,
            by_cpgrl=condition.thresholds is not None and condition.projected, rank=_LONGEST_FIRST.index(name),
        )  # fmt: skip

    def begin(
        self, case: ArmCase, runs: Sequence[int], observe: Observer | None = None
    ) -> tuple[Training, CaseRecorder]:
        """From θ₀ = 0."""
        training = Training(
            ARM, arm_policy(ARM), self.gradient_estimator(case.condition), self.learner(case), episodes=case.episodes,
            runs=runs, seed=self.seed, max_change=MAX_CHANGE, observe=observe,
        )  # fmt: skip
        return training, TouchRecorder(len(runs))

    def curves(self, case: TrainingCase, episodes: np.ndarray, values: Mapping[str, np.ndarray]) -> TouchCurves:  # noqa: ARG002
        """By block of episodes."""
        return TouchCurves(ARM, episodes, np.diff(episodes, prepend=0), **values)

    def claims(self, results: Results) -> list[Claim]:
        """Those whose conditions were trained, in the paper's order, then ours."""
        curves = {name: results.curves[name] for name in self.conditions}
        if "b" not in curves:
            return STATEMENTS.judge(ArmEvidence(curves))
        policies = [arm_policy(ARM).with_parameters(own) for own in results.outcomes["b"].parameters]
        beside_star = count_touches(ARM, policies, starts_beside_aversive(ARM), self._rng("b"))
        return STATEMENTS.judge(ArmEvidence(curves, beside_star))

    def figures(self, results: Results) -> Figures:
        """The paper's Fig. 6 and 7, the latter in motion too; fig7-beside: our conditions, beside the paper's."""
        columns = [name for name in self.conditions if name in PAPER] or list(self.conditions)
        drawn = {"fig6": partial(workspace_figure, ARM), "fig7": partial(self._fig7, results, columns)}
        if beside := [name for name in self.conditions if name not in columns]:
            drawn["fig7-beside"] = partial(self._fig7, results, beside)
        return {**drawn, "fig7.gif": partial(self._animate, results, columns)}

    def _animate(self, results: Results, conditions: Sequence[str], path: Path) -> None:
        paths = {}
        for name in conditions:
            policy, starts, rng = self._typical(results, name)
            paths[name] = [arm_path(ARM, policy, start, rng) for start in starts[:: len(starts) // _ANIMATED]]
        write_animation(ARM, paths, _titles(paths), path)

    def _fig7(self, results: Results, conditions: Sequence[str]) -> Any:
        paths = {}
        for name in conditions:
            policy, starts, rng = self._typical(results, name)
            paths[name] = typical_path(ARM, policy, starts[0], rng)
        return touches_figure(results.curves, paths, _titles(conditions))

    def _typical(self, results: Results, condition: str) -> tuple[NormalizedGaussianNetwork, Any, np.random.Generator]:
        """A typical run's policy, starts, and a stream for what it draws."""
        run = typical_run(results.curves[condition])
        policy = arm_policy(ARM).with_parameters(results.outcomes[condition].parameters[run])
        return policy, starts_beside_aversive(ARM), self._rng(condition)

    def _rng(self, condition: str) -> np.random.Generator:
        place = list(CONDITIONS).index(condition)
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(_DRAWING, place)))

    def comparisons(self) -> list[Comparison]:
        """Of formulations, if asked for."""
        keys = {case.label: (case.condition, case.formulation, case.solver) for case in self.compared()}
        return [formulation_table(keys)] if keys else []

    def summary(self, results: Results) -> dict[str, Any]:  # noqa: ARG002
        """The safeguards."""
        safeguards = {
            "ours": "the printed update diverges on the arm without them",
            "ridge": self.ridge,
            "max_restoration": self.max_restoration if np.isfinite(self.max_restoration) else None,
            "drop": self.drop,
        }
        return {"safeguards": safeguards}

    def summary_of(self, case: ArmCase, results: Results) -> dict[str, Any]:  # noqa: ARG002
        """What was asked of it."""
        condition = CONDITIONS[case.condition]
        asked = {"thresholds": condition.thresholds, "average": condition.average, "projected": case.by_cpgrl}
        return {**asked, "solver": case.solver, "formulation": case.formulation}

    def remarks(self) -> list[str]:
        """The safeguards."""
        return [
            f"Safeguards, our additions: ridge = {self.ridge:g}, max_restoration = {self.max_restoration:g}, "
            f"drop = {self.drop}."
        ]


def arm_policy(arm: TwoLinkArm) -> NormalizedGaussianNetwork:
    """Forty basis functions over what the stops allow, θ₀ = 0, exploration of unit variance.

    Parameters
    ----------
    arm
        Whose stops bound the centres.

    Returns
    -------
    NormalizedGaussianNetwork
        Θ has 80 components.
    """
    return NormalizedGaussianNetwork(*arm.stops, _BASIS, 2)


def _titles(conditions: Iterable[str]) -> dict[str, str]:
    return {name: CONDITIONS[name].title for name in conditions}
