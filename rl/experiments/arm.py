"""The paper's second experiment (§4): CPGRL on the two-link arm, with and without constraints, and beside formulations.

The claims are what §4.2 of the paper says of Fig. 7, and what the figure does not say, against touches of the objects.
Their margins were set before a full run was looked at, wide against the spread over seeds (docs/reproduction.md, §3),
but for b-avoids-star: its margins are the first ones, what they are held against is not. It asked for the mean of all
episodes from SETTLED on; since runs were looked at it asks for the thousand from there and for the last ones, each.
Rates are touches per 100 episodes, means over the runs; "early" and "late" as in TouchCurves.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from cpgrl_opt import FORMULATIONS, ConstrainedStep
from cpgrl_opt.arrays import Float
from cpgrl_opt.step import Observer
from envs import TwoLinkArm

from ..estimators import GPOMDP, GradientEstimator, KondaActorCritic
from ..learners import CPGRL, GradientWithRestoration, Learner, WeightedSum
from ..policies import NormalizedGaussianNetwork
from ..training import Training, TrainingRecord
from .arm_animation import write_animation
from .arm_bound import greatest_average_r3
from .arm_figures import touches_figure, workspace_figure
from .arm_paths import ArmPath, arm_path, starts_beside_aversive, touched_from, typical_path, typical_run
from .claims import Claim, Statements, Verdict
from .comparison import Comparison, Measure, with_spread
from .experiment import CaseRecorder, Experiment, Results, TrainingCase, option
from .messages import Outcome
from .touch_curves import TouchCurves

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ESTIMATORS = ("konda", "gpomdp")
PAPER = ("a", "b", "c")  # the columns of Fig. 7
MAX_CHANGE = 10.0  # of a component of θ in an update: a training that goes further has diverged, and says so
_BASIS = (5, 8)  # 40 basis functions (§4.1), 8 of them along φ₂
_ANIMATED = 4  # episodes of the animation, from as many directions around the star
_DRAWING = 1 << 32  # spawn key of what is drawn for figures: beyond that of any run


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
# By what an episode takes: without a square to reach, or with time to wait, episodes are long.
_LONGEST_FIRST = ("b", "a", "c-episode", "c", "c-no-projection", "c-feasible")

# --compare: (b) and (c) under each formulation, by a solver that takes it.
COMPARED_CONDITIONS = ("b", "c")
COMPARED_STEPS = (
    ("rosen", "equality"),
    ("active-set", "cone"),
    ("active-set", "restoring"),
    ("active-set", "linearized"),
)
_OUTCOMES = (*TwoLinkArm().events, "none")
MEASURES = (
    *(Measure(outcome, outcome, ".1f") for outcome in _OUTCOMES),  # per 100 of the last episodes
    Measure("early_violation", "outside, first", ".4f"),
    Measure("violation", "outside, last", ".4f"),
    Measure("length", "steps", ".1f"),
    Measure("constrained", "constrained", ".3f"),
    Measure("capped", "shortened", ".3f"),
    Measure("infeasible", "infeasible", ".3f"),
    Measure("uncertified", "uncertified", ".3g"),
)
_LEGEND = (
    "Mean ± standard deviation over the runs. Touches per 100 of the last episodes by object, time-outs under none. "
    "Outside: share of steps outside the box of r², in the first and in the last episodes. Steps: mean length of the "
    "last episodes. Per update: constrained (a constraint is active, and the ridge acts; under linearized, which has "
    "none, a constraint has a multiplier), restorations shortened, subproblems without a solution (least violation "
    "taken), answers without certificate (active-set took over, or θ stayed)."
)
STATEMENTS = Statements()
SETTLED = 1000  # "after about 1 × 10³ episodes"
OURS = "not in the paper"
_OTHERS = ("circle", "star", "triangle")  # than the square


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
    recorded = MappingProxyType({"touches": _OUTCOMES, "violation": ["violation"], "length": ["length"]})
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
        if self.estimator not in ESTIMATORS:
            raise ValueError(f"estimator should be one of {', '.join(ESTIMATORS)}; found {self.estimator!r}")
        if not self.conditions or isinstance(self.conditions, str):
            raise ValueError(f"conditions should be some of {', '.join(CONDITIONS)}; found {self.conditions!r}")
        for name in self.conditions:
            if name not in CONDITIONS:
                raise ValueError(f"conditions should be some of {', '.join(CONDITIONS)}; found {name!r}")
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
        shared = {**self.estimated(), "average": CONDITIONS[condition].average}
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
        arm = TwoLinkArm()
        training = Training(
            arm, arm_policy(arm), self.gradient_estimator(case.condition), self.learner(case), episodes=case.episodes,
            runs=runs, seed=self.seed, max_change=MAX_CHANGE, observe=observe,
        )  # fmt: skip
        return training, _Touches(len(runs))

    def curves(self, case: TrainingCase, episodes: np.ndarray, values: Mapping[str, np.ndarray]) -> TouchCurves:  # noqa: ARG002
        """By block of episodes."""
        return TouchCurves(TwoLinkArm(), episodes, np.diff(episodes, prepend=0), **values)

    def claims(self, results: Results) -> list[Claim]:
        """Those whose conditions were trained, in the paper's order, then ours."""
        return STATEMENTS.judged(self.evidence(results))

    def evidence(self, results: Results) -> "ArmEvidence":
        """What the claims are judged by."""
        curves = {name: results.curves[name] for name in self.conditions}
        if "b" not in curves:
            return ArmEvidence(curves)
        arm = TwoLinkArm()
        policies = [learned_policy(arm, own) for own in results.outcomes["b"].parameters]
        return ArmEvidence(curves, touched_from(arm, policies, starts_beside_aversive(arm), self._rng("b")))

    def figures(self, results: Results) -> "dict[str, Callable[[], Figure]]":
        """The paper's Fig. 6 and 7; fig7-beside holds our conditions where the paper's were trained."""
        figures: dict[str, Callable[[], Figure]] = {"fig6": lambda: workspace_figure(TwoLinkArm())}
        beside = [name for name in self.conditions if name not in self._columns()]
        for name, conditions in (("fig7", self._columns()), ("fig7-beside", beside)):
            if conditions:
                figures[name] = partial(self._fig7, results, conditions)
        return figures

    def _columns(self) -> list[str]:
        return [name for name in self.conditions if name in PAPER] or list(self.conditions)

    def _fig7(self, results: Results, conditions: Sequence[str]) -> "Figure":
        paths = {}
        for name in conditions:
            arm, policy, starts, rng = self._typical(results, name)
            paths[name] = typical_path(arm, policy, starts[0], rng)
        return touches_figure(results.curves, paths, _titles(conditions))

    def animations(self, results: Results) -> dict[str, Callable[[Path], object]]:
        """Episodes of typical runs."""
        paths = {name: list(self._episodes(results, name)) for name in self._columns()}
        return {"fig7.gif": partial(write_animation, TwoLinkArm(), paths, _titles(paths))}

    def _episodes(self, results: Results, condition: str) -> Iterator[ArmPath]:
        arm, policy, starts, rng = self._typical(results, condition)
        return (arm_path(arm, policy, start, rng) for start in starts[:: len(starts) // _ANIMATED])

    def _typical(self, results: Results, condition: str) -> tuple[TwoLinkArm, NormalizedGaussianNetwork, Any, Any]:
        """The arm, a typical run's policy, starts, and a stream for what it draws."""
        arm, run = TwoLinkArm(), typical_run(results.curves[condition])
        policy = learned_policy(arm, results.outcomes[condition].parameters[run])
        return arm, policy, starts_beside_aversive(arm), self._rng(condition)

    def _rng(self, condition: str) -> np.random.Generator:
        place = list(CONDITIONS).index(condition)
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(_DRAWING, place)))

    def comparisons(self) -> list[Comparison]:
        """Of formulations, if asked for."""
        if not self.compare:
            return []
        return [
            Comparison(
                file="compare",
                title="The arm under each formulation",
                legend=_LEGEND,
                headings=("condition", "formulation", "solver", "run", "episode"),
                keys={case.label: (case.condition, case.formulation, case.solver) for case in self.compared()},
                measures=MEASURES,
                measure=measured,
                cells=with_spread,
            )
        ]

    def summary(self, results: Results) -> dict[str, Any]:  # noqa: ARG002
        """The safeguards."""
        return {
            "safeguards": {
                "ours": "the printed update diverges on the arm without them",
                "ridge": self.ridge,
                "max_restoration": self.max_restoration if np.isfinite(self.max_restoration) else None,
                "drop": self.drop,
            }
        }

    def summary_of(self, case: ArmCase, results: Results) -> dict[str, Any]:  # noqa: ARG002
        """What was asked of it."""
        condition = CONDITIONS[case.condition]
        return {
            "thresholds": condition.thresholds,
            "average": condition.average,
            "projected": case.by_cpgrl,
            "solver": case.solver,
            "formulation": case.formulation,
        }

    def remarks(self) -> list[str]:
        """The safeguards."""
        return [
            f"Safeguards, our additions: ridge = {self.ridge:g}, max_restoration = {self.max_restoration:g}, "
            f"drop = {self.drop}."
        ]


class _Touches(CaseRecorder):
    """By what the episodes since the last record ended, and their steps, outside the box of r² and all."""

    carried = ("touches", "steps", "outside", "size")

    def __init__(self, runs: int) -> None:
        self.runs = np.arange(runs)
        self._begin()

    def _begin(self) -> None:
        self.touches = np.zeros((len(self.runs), len(_OUTCOMES)), dtype=np.int64)
        self.steps, self.outside = np.zeros((2, len(self.runs)))
        self.size = 0

    def see(self, record: TrainingRecord) -> Mapping[str, np.ndarray]:
        """Counts "constrained": updates with an active constraint, in each of which the ridge acts."""
        estimate = record.estimate
        self.touches[self.runs, estimate.events - 1] += 1  # a time-out, event 0, in the last column
        self.steps += estimate.steps
        self.outside -= estimate.rewards[:, 1]  # r² = −1 outside the box, else 0
        self.size += 1
        return {"constrained": np.asarray(record.update.active.any(axis=1), dtype=np.int64)}

    def values(self) -> dict[str, np.ndarray]:
        """As in TouchCurves."""
        found = {
            "touches": self.touches,
            "violation": self.outside / self.steps,
            "length": self.steps / self.size,
        }
        self._begin()
        return found


def arm_policy(arm: TwoLinkArm) -> NormalizedGaussianNetwork:
    """Forty basis functions over what the stops allow, θ₀ = 0, exploration of unit variance."""
    return NormalizedGaussianNetwork(*arm.stops, _BASIS, 2)


def learned_policy(arm: TwoLinkArm, parameters: np.ndarray) -> NormalizedGaussianNetwork:
    """The same at θ, (80,)."""
    return arm_policy(arm).with_parameters(parameters)


def measured(curves: TouchCurves, outcome: Outcome) -> Float[np.ndarray, "R measures"]:
    """A row for each run: touches per 100 of the last episodes, then the rest of MEASURES.

    violation: share of steps outside the box, in the first and in the last episodes; length: mean of the last ones.
    constrained, capped, infeasible, uncertified: per update, how often a constraint was active, the restoration was
    shortened, a subproblem had no solution, an answer came without certificate (active-set took over, or θ stayed).
    """
    late, updates = curves.late(), outcome.episode
    counts = outcome.counts
    length = (late.length * late.sizes).sum(axis=1) / late.sizes.sum()
    shares = [counts["constrained"], counts["capped"], counts["infeasible"], counts["fallback"] + counts["skipped"]]
    columns = [curves.early().outside(), late.outside(), length, *(share / updates for share in shares)]
    return np.column_stack([late.rates(), *columns])


def _titles(conditions: Iterable[str]) -> dict[str, str]:
    return {name: CONDITIONS[name].title for name in conditions}


@dataclass(frozen=True, eq=False)
class ArmEvidence:
    """Curves by condition; beside_star: of 100 episodes of (b)'s last policies from beside the star, the ends."""

    curves: Mapping[str, TouchCurves]
    beside_star: Mapping[str, float] = field(default_factory=dict)


@STATEMENTS.add(
    "a-learns-touching",
    "Since r¹ was a dense reward function, it was not hard to obtain touching behaviours",
    "§4.2, Fig. 7 (a)",
    needs=("a",),
)
def a_learns_touching(evidence: ArmEvidence) -> Verdict:
    """(a): at most 5 of 100 late episodes end without a touch."""
    none = _mean(evidence.curves["a"].late(), "none")
    measured = {"episodes_without_touch": none, "at_most": 5}
    words = f"{none:.1f} of 100 late episodes end without a touch; ≤ 5 asked"
    return none <= 5, measured, words


@STATEMENTS.add(
    "b-touches-star-early",
    "At the early stage of learning, the robotic arm touched the aversive star object",
    "§4.2, Fig. 7 (b)",
    needs=("b",),
)
def b_touches_star_early(evidence: ArmEvidence) -> Verdict:
    """(b): at least 8 of 100 among the first episodes."""
    star = _mean(evidence.curves["b"].early(), "star")
    measured = {"star_first": star, "at_least": 8}
    words = f"{star:.1f} of 100 early episodes end at the star; ≥ 8 asked"
    return star >= 8, measured, words


@STATEMENTS.add(
    "b-avoids-star",
    "it learned to avoid the aversive star object after about 1 × 10³ episodes",
    "§4.2, Fig. 7 (b)",
    needs=("b",),
)
def b_avoids_star(evidence: ArmEvidence) -> Verdict:
    """(b): in the thousand episodes from SETTLED on, and at last, at most 10 of 100, and 0.6 times the early rate."""
    learned = evidence.curves["b"]
    first, last = _mean(learned.early(), "star"), _mean(learned.late(), "star")
    after = _mean(learned.within(SETTLED, 2 * SETTLED), "star")
    measured = {"star_early": first, "star_after": after, "star_late": last, "after_episode": SETTLED,
        "at_most": 10, "times_early": 0.6}  # fmt: skip
    words = (
        f"{first:.1f} of 100 early episodes end at the star, {after:.1f} of those from {SETTLED} to {2 * SETTLED}, "
        f"{last:.1f} of the late ones; ≤ 10 and ≤ 0.6 times the early ones asked"
    )
    return max(after, last) <= min(10, 0.6 * first), measured, words


@STATEMENTS.add(
    "b-touches-triangle",
    "The end-effector was initially located in the neighbourhood of the aversive star object, but the arm touched "
    "the triangular object",
    "§4.2, Fig. 7 (b)",
    needs=("b",),
)
def b_touches_triangle(evidence: ArmEvidence) -> Verdict:
    """(b): at least 50 of 100 late episodes, and 60 of 100 from beside the star, end at the triangle."""
    late, beside = evidence.curves["b"].late(), evidence.beside_star
    triangle = _mean(late, "triangle")
    measured = {**_rates("late", late), "late_at_least": 50,
        **{f"beside_star_{name}": rate for name, rate in beside.items()}, "beside_star_at_least": 60}  # fmt: skip
    words = (
        f"from all around the star {beside['triangle']:.1f} of 100 episodes end at the triangle (≥ 60 asked), "
        f"{beside['star']:.1f} at the star. Late episodes: {_told(late)}; triangle ≥ 50 asked"
    )
    return triangle >= 50 and beside["triangle"] >= 60, measured, words


@STATEMENTS.add(
    "b-keeps-joint-angles",
    "Under G² = 0 the joint angles are kept within the bounds of r²",
    "§4.1, eq. of r²",
    needs=("b",),
)
def b_keeps_angles(evidence: ArmEvidence) -> Verdict:
    """(b): at most 1 % of the last steps leave the box of r²."""
    outside = float(evidence.curves["b"].late().outside().mean())
    measured = {"share_outside": outside, "at_most": 0.01}
    words = f"{outside:.2%} of the last steps leave them; ≤ 1 % asked"
    return outside <= 0.01, measured, words


@STATEMENTS.add(
    "c-square-increases", "the number of touches on the square objects increases", "§4.2, Fig. 7 (c)", needs=("c",)
)
def c_square_increases(evidence: ArmEvidence) -> Verdict:
    """(c): at least 80 of 100 late episodes, and 1.1 times as many as in the first block."""
    first, last = _mean(_opening(evidence.curves["c"]), "square"), _mean(evidence.curves["c"].late(), "square")
    measured = {"square_first_block": first, "square_last": last, "at_least": 80, "times_first": 1.1}
    words = f"from {first:.1f} to {last:.1f} of 100 episodes; ≥ 80 and 1.1 times the first block asked"
    return last >= max(80, 1.1 * first), measured, words


@STATEMENTS.add(
    "c-others-vanish", "while those on other objects are gradually reduced to zero", "§4.2, Fig. 7 (c)", needs=("c",)
)
def c_others_vanish(evidence: ArmEvidence) -> Verdict:
    """(c): circle, star and triangle together at most 15 of 100 at last, and half of the first block's."""
    learned = evidence.curves["c"]
    first, last = _others(_opening(learned)), _others(learned.late())
    few = sum(learned.per_hundred()[:, :, learned.outcomes.index(name)].mean(axis=0) for name in _OTHERS) <= 15
    since = int(learned.episodes[few.argmax()]) if few.any() else 0
    measured = {"others_first_block": first, "others_last": last, "at_most": 15, "times_first": 0.5,
        "first_so_few_at_episode": since}  # fmt: skip
    words = (
        f"from {first:.1f} to {last:.1f} of 100 episodes{f', first 15 or fewer by episode {since}' if since else ''}; "
        "≤ 15 and half of the first block asked"
    )
    return last <= min(15, 0.5 * first), measured, words


@STATEMENTS.add(
    "threshold-matters",
    "G³ (printed G²) is a sensitive threshold that affects the resultant behaviours",
    "§4.2",
    needs=(
        "b",
        "c",
    ),
)
def threshold_matters(evidence: ArmEvidence) -> Verdict:
    """(c) touches the square at least 50 times more of 100 than (b)."""
    with_zero, with_half = (_mean(evidence.curves[name].late(), "square") for name in ("b", "c"))
    measured = {"square_b": with_zero, "square_c": with_half, "difference_at_least": 50}
    words = f"square touches of 100 late episodes: (b) {with_zero:.1f}, (c) {with_half:.1f}; 50 apart asked"
    return with_half - with_zero >= 50, measured, words


@STATEMENTS.add(
    "a-winner-takes-all",
    "Without constraints a run ends with one object, not with all four, though r¹ is the same at each",
    OURS,
    needs=("a",),
)
def a_winner_takes_all(evidence: ArmEvidence) -> Verdict:
    """(a), mean over the runs: the most touched object has 50 of 100 late episodes, and twice the second's."""
    rates = evidence.curves["a"].late().rates()[:, :-1]
    second, first = (float(rate) for rate in np.sort(rates, axis=1)[:, -2:].mean(axis=0))
    winners = {name: int((rates.argmax(axis=1) == k).sum()) for k, name in enumerate(evidence.curves["a"].arm.events)}
    measured = {"most_touched": first, "second": second, "at_least": 50, "times_second": 2,
        **{f"runs_won_by_{name}": number for name, number in winners.items()}}  # fmt: skip
    words = (
        f"the most touched object has {first:.1f} of 100 late episodes, the second {second:.1f}; ≥ 50 and twice the "
        f"second asked. Most touched: {', '.join(f'{name} in {k}' for name, k in winners.items() if k)} runs"
    )
    return first >= max(50, 2 * second), measured, words


@STATEMENTS.add(
    "c-threshold-out-of-reach",
    "G³ = 0.5 per step cannot be met, a touch taking several steps: in (c) the constraint stays active for ever",
    OURS,
    needs=("c",),
)
def c_out_of_reach(evidence: ArmEvidence) -> Verdict:
    """(c): the bound on ρ³, and what every run reaches, lie below G³."""
    threshold, bound = _threshold("c"), greatest_average_r3(evidence.curves["c"].arm)
    reached = float(max(evidence.curves[name].late().average_r3("step").max() for name in evidence.curves))
    measured = {"greatest_average": bound, "best_reached": reached, "threshold": threshold}
    words = f"no policy exceeds ρ³ = {bound:.3f} per step; the best run of all conditions reaches {reached:.3f}"
    return bound < threshold and reached < threshold, measured, words


@STATEMENTS.add(
    "c-episode-met-with-slack",
    "G³ = 0.5 is met with slack where ρ³ is averaged per episode",
    OURS,
    needs=("c-episode",),
)
def c_episode_met(evidence: ArmEvidence) -> Verdict:
    """(c) with ρ³ per episode: at least 0.6 at last, with slack over 0.5."""
    late = evidence.curves["c-episode"].late()
    average = float(late.average_r3("episode").mean())
    measured = {"average_per_episode": average, "threshold": _threshold("c-episode"), "at_least": 0.6,
        **_rates("late", late)}  # fmt: skip
    words = f"ρ³ = {average:.3f} per episode at last; ≥ 0.6 asked. Late episodes: {_told(late)}"
    return average >= 0.6, measured, words


@STATEMENTS.add("c-feasible-met", "G³ = 0.1 per step, which is feasible, is met", OURS, needs=("c-feasible",))
def c_feasible_met(evidence: ArmEvidence) -> Verdict:
    """(c) with G³ = 0.1: ρ³ at least 0.08 per step at last, the threshold but for a fifth."""
    late = evidence.curves["c-feasible"].late()
    average = float(late.average_r3("step").mean())
    measured = {
        "average_per_step": average,
        "threshold": _threshold("c-feasible"),
        "at_least": 0.08,
        **_rates("late", late),
    }
    words = f"ρ³ = {average:.3f} per step at last; ≥ 0.08 asked. Late episodes: {_told(late)}"
    return average >= 0.08, measured, words


@STATEMENTS.add(
    "projection-not-shown-by-fig7",
    "Fig. 7 does not tell projection from gradient plus restoration: (c) without P ends the same",
    OURS,
    needs=(
        "c",
        "c-no-projection",
    ),
)
def projection_not_shown(evidence: ArmEvidence) -> Verdict:
    """(c) without P: every rate within 15 of 100 of (c)'s."""
    projected, whole = evidence.curves["c"].late(), evidence.curves["c-no-projection"].late()
    apart = float(abs(projected.rates().mean(axis=0) - whole.rates().mean(axis=0)).max())
    measured = {"largest_difference": apart, "at_most": 15, **_rates("with_P", projected), **_rates("without_P", whole)}
    words = f"touches of 100 late episodes differ by {apart:.1f} at most; ≤ 15 asked. Without P: {_told(whole)}"
    return apart <= 15, measured, words


def _mean(curves: TouchCurves, outcome: str) -> float:
    return float(curves.rate(outcome).mean())


def _opening(curves: TouchCurves) -> TouchCurves:
    """The first block."""
    return curves.within(0, int(curves.episodes[0]))


def _others(curves: TouchCurves) -> float:
    return sum(_mean(curves, outcome) for outcome in _OTHERS)


def _rates(prefix: str, curves: TouchCurves) -> dict[str, float]:
    return {f"{prefix}_{outcome}": _mean(curves, outcome) for outcome in curves.outcomes}


def _told(curves: TouchCurves) -> str:
    return ", ".join(f"{outcome} {_mean(curves, outcome):.1f}" for outcome in curves.outcomes)


def _threshold(condition: str) -> float:
    thresholds = CONDITIONS[condition].thresholds
    assert thresholds is not None  # every (c) has both
    return thresholds[1]
