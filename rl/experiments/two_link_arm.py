"""The paper's second experiment (§4): what is trained on the two-link arm, and with which settings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cpgrl_opt import FORMULATIONS, ConstrainedStep
from cpgrl_opt.validation import require_count
from envs import TwoLinkArm

from ..estimators import GPOMDP, GradientEstimator, KondaActorCritic
from ..learners import CPGRL, GradientWithRestoration, Learner, WeightedSum
from ..policies import NormalizedGaussianNetwork
from ..streams import MOST_RUNS

ESTIMATORS = ("konda", "gpomdp")
PAPER = ("a", "b", "c")  # the columns of Fig. 7
_BASIS = (5, 8)  # 40 basis functions (§4.1), 8 of them along φ₂
MAX_CHANGE = 10.0  # of a component of θ in an update: a training that goes further has diverged, and says so


@dataclass(frozen=True)
class Condition:
    """What is asked of a training besides r¹.

    title: for figures; thresholds (G², G³), None without constraints; average: whether ρ of r¹, r², r³ is per step or
    per episode; projected: whether the gradient is projected, as CPGRL does.
    """

    title: str
    thresholds: tuple[float, float] | None
    average: tuple[str, str, str] = ("step", "step", "step")
    projected: bool = True


# a, b, c are the paper's; the others are ours.
CONDITIONS = {
    "a": Condition("no constraints", None),
    "b": Condition("$G^2 = G^3 = 0$", (0.0, 0.0)),
    "c": Condition("$G^2 = 0$, $G^3 = 0.5$", (0.0, 0.5)),
    "c-episode": Condition("$G^3 = 0.5$ per episode", (0.0, 0.5), ("step", "step", "episode")),
    "c-feasible": Condition("$G^3 = 0.1$", (0.0, 0.1)),
    "c-no-projection": Condition("$G^3 = 0.5$, without $P$", (0.0, 0.5), projected=False),
}


@dataclass(frozen=True)
class Case:
    """One training: a condition under a solver and a formulation; label: its name in progress and results."""

    label: str
    condition: str
    solver: str
    formulation: str


# --compare: (b) and (c) under each formulation, by a solver that takes it.
COMPARED_CONDITIONS = ("b", "c")
COMPARED_STEPS = (
    ("rosen", "equality"),
    ("active-set", "cone"),
    ("active-set", "restoring"),
    ("active-set", "linearized"),
)


@dataclass(frozen=True, kw_only=True)
class ArmSettings:
    """Settings of the experiment; rates are the paper's (§3.1, "the same meta-parameters"), the rest ours where it
    is silent.

    runs, episodes N_K, steps N_T per episode at most, seed, record_every (episodes in a row of learning.csv): whole
    numbers. solver, formulation: names from SOLVERS and FORMULATIONS; estimator: one of ESTIMATORS; conditions: some
    of CONDITIONS, put into their order. step_size α₁, restoration_rate αₑ, average_rate α_r, critic_rate α_w,
    trace_decay β. Safeguards, ours, without which the printed update diverges on the arm: ridge ε in the squared
    unit of a gradient, max_restoration ‖αₑ d‖ in the unit of θ; drop: see `ConstrainedStep`.
    gradient: eq. 5 and 3 as printed, the mean over each episode's own steps, and bias_correction: eq. 4 as printed,
    from 0, see `KondaActorCritic`.
    record: how many direction problems of each constrained case to keep, 0 for none.
    Raises ValueError for bad numbers and unknown names.
    """

    runs: int = 20
    episodes: int = 10_000
    steps: int = 1000
    seed: int = 0
    solver: str = "rosen"
    formulation: str = "equality"
    estimator: str = "konda"
    conditions: Sequence[str] = tuple(CONDITIONS)
    record_every: int = 100
    step_size: float = 0.02
    restoration_rate: float = 0.02
    average_rate: float = 0.02
    critic_rate: float = 0.02
    trace_decay: float = 0.99
    ridge: float = 1e-4
    max_restoration: float = 0.1
    drop: str = "never"
    gradient: str = "episode mean"
    bias_correction: bool = False
    compare: bool = False
    record: int = 0

    def __post_init__(self) -> None:
        require_count("runs", self.runs, most=MOST_RUNS)
        for name in ("episodes", "steps", "record_every"):
            require_count(name, getattr(self, name))
        for name in ("seed", "record"):
            require_count(name, getattr(self, name), 0)
        if self.estimator not in ESTIMATORS:
            raise ValueError(f"estimator should be one of {', '.join(ESTIMATORS)}; found {self.estimator!r}")
        if not self.conditions or isinstance(self.conditions, str):
            raise ValueError(f"conditions should be some of {', '.join(CONDITIONS)}; found {self.conditions!r}")
        for name in self.conditions:
            if name not in CONDITIONS:
                raise ValueError(f"conditions should be some of {', '.join(CONDITIONS)}; found {name!r}")
        object.__setattr__(self, "conditions", tuple(name for name in CONDITIONS if name in self.conditions))
        self.step()
        self.gradient_estimator("a")

    def step(self, solver: str | None = None, formulation: str | None = None) -> ConstrainedStep:
        """The step with its safeguards; this solver and formulation instead of the settings' own if given.

        "linearized" goes without the ridge, which it does not take.
        """
        formulation = formulation or self.formulation
        return ConstrainedStep(
            solver=solver or self.solver,
            formulation=formulation,
            step_size=self.step_size,
            restoration_rate=self.restoration_rate,
            drop=self.drop,
            ridge=0.0 if formulation == "linearized" else self.ridge,
            max_restoration=self.max_restoration,
        )

    def gradient_estimator(self, condition: str) -> GradientEstimator:
        """Eq. 5, or eq. 3, with eq. 4."""
        shared: dict[str, Any] = {
            "trace_decay": self.trace_decay,
            "average_rate": self.average_rate,
            "average": CONDITIONS[condition].average,
            "steps": self.steps,
            "gradient": self.gradient,
            "bias_correction": self.bias_correction,
        }
        if self.estimator == "gpomdp":
            return GPOMDP(**shared)
        return KondaActorCritic(**shared, critic_rate=self.critic_rate)

    def learner(self, case: Case) -> Learner:
        """Plain policy gradient of r¹, CPGRL, or gradient plus restoration.

        Without P "restoring" and "linearized" have no restoration of their own; that of "cone" stands in.
        """
        condition = CONDITIONS[case.condition]
        if condition.thresholds is None:
            return WeightedSum([1, 0, 0], step_size=self.step_size)
        step = self.step(case.solver, case.formulation)
        if condition.projected:
            return CPGRL(step, condition.thresholds)
        if FORMULATIONS[step.formulation].restores_inside:
            step = replace(step, formulation="cone")
        return GradientWithRestoration(step, condition.thresholds)

    def cases(self) -> list[Case]:
        """The conditions, then what is compared with them; the settings' own step is not trained twice."""
        own = [Case(name, name, self.solver, self.formulation) for name in self.conditions]
        return own + [case for case in self.compared() if case not in own]

    def compared(self) -> list[Case]:
        """The cases of the comparison, those that are a condition's own among them."""
        if not self.compare:
            return []
        return [self._compared(condition, *step) for condition in COMPARED_CONDITIONS for step in COMPARED_STEPS]

    def _compared(self, condition: str, solver: str, formulation: str) -> Case:
        own = condition in self.conditions and (solver, formulation) == (self.solver, self.formulation)
        return Case(condition if own else f"{condition}, {formulation}", condition, solver, formulation)


def arm_policy(arm: TwoLinkArm) -> NormalizedGaussianNetwork:
    """Forty basis functions over what the stops allow, θ₀ = 0, exploration of unit variance."""
    return NormalizedGaussianNetwork(*arm.stops, _BASIS, 2)


def learned_policy(arm: TwoLinkArm, parameters: np.ndarray) -> NormalizedGaussianNetwork:
    """The same at θ, (80,)."""
    return arm_policy(arm).with_parameters(parameters)
