"""What does `linearized` buy and cost beside `restoring`: violations on the way, and the return after as many updates?

Three tasks, each learned from the same θ₀ and random streams with `restoring` and with `linearized`, κ = 1 and ½, at
equal rates α₁, αₑ:

    exact     the gridworld with exact ρ and ∇ρ; a run is a θ₀ ~ U[0, 1]ⁿ
    estimated the gridworld with GPOMDP, ρ carried over about 1000 steps
    arm       the two-link arm with Konda's actor-critic at the paper's rates, so that ρ is a mean of about 50 steps

A policy is judged by the worst of its slacks, slackᵢ/|Gⁱ|. On the gridworld ρ is the exact one of the policy after each
update, whatever the learner was told; on the arm, where nobody knows it, the mean over a fortieth of the episodes.

    python benchmarks/violations_on_the_way.py [--seeds 20] [--scale 1] [--out benchmarks/results]

--scale: part of the updates that are made. Limitations: one size and slip of the gridworld, rates chosen by hand once
for both formulations, and on the arm a mean over episodes has noise of its own, which also makes violations.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import comb
from pathlib import Path
from typing import Any

import numpy as np
from tables import publish, read_arguments

from cpgrl_opt import ConstrainedStep
from envs import GridWorld, TwoLinkArm
from rl.estimators import GPOMDP, ExactGradient, GradientEstimator, KondaActorCritic
from rl.experiments.arm.experiment import MAX_CHANGE, arm_policy
from rl.experiments.figure_style import (
    BLUE,
    DOTS_PER_INCH,
    GREEN,
    PAGE_WIDTH,
    VERMILION,
    blank_figure,
    caption,
    panel_letter,
    paper_style,
)
from rl.learners import CPGRL
from rl.policies import SoftmaxTable
from rl.training import TrainingRecord, train, uniform_parameters

METHODS = {
    "restoring": ("restoring", 1.0),
    "linearized, κ = 1": ("linearized", 1.0),
    "linearized, κ = ½": ("linearized", 0.5),
}
BLOCKS = 40  # of episodes, on the arm
_ROUNDING = 1e-9  # of exact averages, in units of a threshold: no violation
_NOTICED = 0.01  # of a threshold
# Columns of the page: of a Row, heading, digits, unit.
_COLUMNS = (
    ("violated", "violated, %", 1, 100),
    ("noticed", "by > 1 %, %", 1, 100),
    ("violated_late", "second half, %", 1, 100),
    ("largest", "largest, %", 1, 100),
    ("mean", "mean, %", 3, 100),
    ("returned", "return", 3, 1),
    ("infeasible", "infeasible", 1, 1),
)
_ABOUT = """Medians over the runs, and intervals that hold the true median with at least 95 % chance (order statistics).

- violated: share of updates after which a constraint is violated; by > 1 %: by more than 1 % of its threshold; second \
half: of training
- largest, mean: violation of the worst constraint over all updates, 0 where all are met, in % of its threshold
- return: ρ¹ in the last twentieth, on the gridworld over that of the best feasible policy
- infeasible: updates of a run in which nothing meets the linearized constraints"""
# Line and colour of each method, in their order; told apart in grey by the dashes.
_LOOKS = ((VERMILION, "-"), (BLUE, "-"), (GREEN, (0, (4, 1.5))))
_LINEAR = 0.1  # slack, in units of the threshold, within which a long axis is linear
_LONG = 1.0  # an axis that goes further down is logarithmic there
_MOMENTS = 250  # drawn at most; more would only blacken the noise


@dataclass(frozen=True, eq=False)
class Task:
    """What is learned, at which rates; best: the exact optimum, None where nobody knows it.

    look: what is kept of a record, (B, …); rewards: of all of these, in order, ρ of (B, moments, 1 + m).
    """

    title: str
    setting: dict[str, Any]
    thresholds: tuple[float, ...]
    updates: int
    rates: dict[str, float]
    look: Callable[[TrainingRecord], np.ndarray]
    rewards: Callable[[np.ndarray], np.ndarray]
    best: float | None = None


@dataclass(frozen=True, eq=False)
class Course:
    """Runs of one method on one task: ρ at some moments, and how often nothing met the linearized constraints."""

    task: Task
    values: np.ndarray
    infeasible: np.ndarray

    @property
    def slack(self) -> np.ndarray:
        """(runs, moments): min slackᵢ/|Gⁱ|."""
        thresholds = np.array(self.task.thresholds)
        return ((self.values[:, :, 1:] - thresholds) / np.abs(thresholds)).min(axis=2)

    @property
    def returns(self) -> np.ndarray:
        """(runs, moments): ρ¹, over the best where that is known."""
        return self.values[:, :, 0] / (self.task.best or 1.0)


@dataclass(frozen=True)
class Row:
    """One run: shares of its moments, violations in units of the threshold, the return of its last twentieth."""

    task: str
    method: str
    seed: int
    violated: float
    noticed: float
    violated_late: float
    largest: float
    mean: float
    returned: float
    infeasible: int


def tasks(scale: float) -> dict[str, Task]:
    """The three of them, with this part of their updates."""
    exact, estimated, arm = (max(BLOCKS, round(scale * updates)) for updates in (300, 1000, 4000))
    gpomdp = GPOMDP(steps=1000, average_rate=0.001, trace_decay=0.98)
    return {
        "exact": gridworld("gridworld, exact gradients", ExactGradient(), exact, 30.0),
        "estimated": gridworld("gridworld, GPOMDP", gpomdp, estimated, 3.0),
        "arm": reaching("arm, actor-critic", arm),
    }


def gridworld(title: str, estimator: GradientEstimator, updates: int, step_size: float) -> Task:
    """Goals per step while each kind of hazard takes at most a twentieth of the time."""
    world = GridWorld()
    policy = SoftmaxTable(world.states, world.actions)
    thresholds = (-0.05, -0.05)

    def averages(parameters: np.ndarray) -> np.ndarray:
        return world.average_rewards(policy.probabilities(parameters.swapaxes(0, 1)))

    setting = {"environment": world, "policy": policy, "estimator": estimator}
    return Task(
        title,
        {**setting, "initial": uniform_parameters(len(policy.parameters))},
        thresholds,
        updates,
        {"step_size": step_size, "restoration_rate": 0.1},
        lambda record: record.parameters,
        averages,
        float(world.constrained_optimum(thresholds).values[0]),
    )


def reaching(title: str, updates: int) -> Task:
    """Near an object, at most a twentieth of the time outside the box, a touch of the square each twenty steps."""
    arm = TwoLinkArm()
    setting = {"environment": arm, "policy": arm_policy(arm), "estimator": KondaActorCritic()}
    return Task(
        title,
        {**setting, "max_change": MAX_CHANGE},
        (-0.05, 0.05),
        updates,
        {"step_size": 0.02, "restoration_rate": 0.02, "max_restoration": 0.1},
        lambda record: np.column_stack([record.estimate.rewards, record.estimate.steps]),
        block_means,
    )


def block_means(sums: np.ndarray) -> np.ndarray:
    """Rewards per step in each of BLOCKS blocks of episodes, (runs, BLOCKS, 1 + m).

    sums: of an episode's rewards, and its steps, (episodes, runs, 1 + m + 1).
    """
    blocks = np.array([block.sum(axis=0) for block in np.array_split(sums, BLOCKS)])
    return (blocks[..., :-1] / blocks[..., -1:]).swapaxes(0, 1)


def learn(task: Task, method: str, seeds: int) -> Course:
    """All runs in lockstep."""
    formulation, fraction = METHODS[method]
    step = ConstrainedStep(formulation=formulation, slack_fraction=fraction, **task.rates)
    seen, infeasible = [], np.zeros(seeds, dtype=np.int64)
    learner = CPGRL(step, task.thresholds)
    for record in train(learner=learner, episodes=task.updates, runs=seeds, **task.setting):
        seen.append(task.look(record))
        infeasible += record.update.counts["infeasible"]
    return Course(task, task.rewards(np.array(seen)), infeasible)


def measure(name: str, method: str, course: Course) -> list[Row]:
    """A row for each run."""
    violation = np.maximum(-course.slack, 0.0)
    violation[violation <= _ROUNDING] = 0.0
    moments = violation.shape[1]
    columns = (
        (violation > 0).mean(axis=1),
        (violation > _NOTICED).mean(axis=1),
        (violation[:, moments // 2 :] > 0).mean(axis=1),
        violation.max(axis=1),
        violation.mean(axis=1),
        course.returns[:, -max(1, moments // 20) :].mean(axis=1),
    )
    rows = zip(*columns, strict=True)
    return [
        Row(name, method, seed, *(float(f"{each:.6g}") for each in row), infeasible=int(course.infeasible[seed]))
        for seed, row in enumerate(rows)
    ]


def median_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """The median, and order statistics x₍ₖ₎, x₍N+1−k₎ between which the true one lies with at least 95 % chance.

    P(x₍ₖ₎ ≤ median ≤ x₍N+1−k₎) = 1 − 2 Σ_{j<k} C(N, j)/2ᴺ, whatever the distribution. Below six runs even all of them
    are not enough, and these are taken.
    """
    ordered, count, below, k = np.sort(values), len(values), 0, 0
    while k < count and 2 * (below + comb(count, k)) <= 0.05 * 2**count:
        below += comb(count, k)
        k += 1
    first = max(k, 1) - 1
    return float(np.median(ordered)), float(ordered[first]), float(ordered[count - 1 - first])


def cell(values: Sequence[float], digits: int) -> str:
    """Median (low … high)."""
    middle, low, high = (f"{value:.{digits}f}" for value in median_interval(values))
    return f"{middle} ({low} … {high})"


def summarise(rows: Sequence[Row]) -> str:
    """A line for each task and method, medians with their intervals."""
    lines = []
    for name, method in dict.fromkeys((row.task, row.method) for row in rows):
        runs = [row for row in rows if (row.task, row.method) == (name, method)]
        cells = [cell([unit * getattr(run, column) for run in runs], digits) for column, _, digits, unit in _COLUMNS]
        lines.append(" | ".join([name, method, *cells]))
    titles = ["task", "method", *(title for _, title, _, _ in _COLUMNS)]
    return "\n".join(f"| {line} |" for line in [" | ".join(titles), "|".join(["---"] * len(titles)), *lines])


def describe(name: str, task: Task) -> str:
    """A line of the page: rates and the best return, where it is known."""
    rates = ", ".join(f"{key} {value:g}" for key, value in task.rates.items())
    best = "" if task.best is None else f", best ρ¹ {task.best:.4f}"
    return f"- {name}: {task.title}; {task.updates} updates, thresholds {task.thresholds}, {rates}{best}"


def write_figure(courses: Mapping[tuple[str, str], Any], path: Path) -> None:
    """A column for each task: above the slack, below the return; courses by (task, method)."""
    names = list(dict.fromkeys(name for name, _ in courses))
    with paper_style():
        figure = blank_figure(PAGE_WIDTH, 4.2)
        panels = figure.subplots(2, len(names), sharex="col")
        figure.subplots_adjust(left=0.09, right=0.975, top=0.87, bottom=0.2, wspace=0.27, hspace=0.12)
        for column, name in enumerate(names):
            mine = {method: course for (task, method), course in courses.items() if task == name}
            _draw_task(panels[:, column], mine, "abc"[column])
        panels[0, 0].set_ylabel("slack, % of threshold")
        panels[1, 0].set_ylabel("return")
        figure.align_ylabels(panels[:, 0])
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper center", ncols=len(labels), columnspacing=2.0)
        runs = len(next(iter(courses.values())).values)
        caption(
            figure,
            f"Median (line) and middle 80 % (band) of {runs} runs. Above: the worst constraint, violated where shaded; "
            f"(c) is logarithmic beyond\n±{100 * _LINEAR:.0f} %. Below: $\\rho^1$, on the gridworld over that of the "
            "best feasible policy. Exact on the gridworld, means over episodes on the arm.",
        )
        figure.savefig(path, dpi=DOTS_PER_INCH)


def _draw_task(panels: Any, courses: Mapping[str, Any], letter: str) -> None:
    above, below = panels
    task = next(iter(courses.values())).task
    for (method, course), look in zip(courses.items(), _LOOKS, strict=True):
        _draw_band(above, course.slack, task.updates, look, method)
        _draw_band(below, course.returns, task.updates, look, method)
    _shade_violations(above)
    panel_letter(above, letter, task.title)
    below.set(xlabel="updates", xlim=(0, task.updates))


def _shade_violations(axes: Any) -> None:
    low, high = axes.get_ylim()
    if low < -_LONG:
        axes.set_yscale("symlog", linthresh=_LINEAR, linscale=1.0)
        axes.set_yticks([*(-(10.0**power) for power in range(int(np.log10(-low)), -2, -1)), 0.0, _LINEAR])
        axes.minorticks_off()
    axes.axhspan(2 * low - 1, 0, color="0.93", lw=0, zorder=0)
    axes.axhline(0, color="0.3", lw=0.6, zorder=1)
    axes.set_ylim(low, high)
    axes.yaxis.set_major_formatter(lambda slack, _: f"{100 * slack:.0f}".replace("-", "−"))


def _draw_band(axes: Any, values: np.ndarray, updates: int, look: tuple[str, Any], label: str) -> None:
    colour, dashes = look
    drawn = slice(None, None, -(-values.shape[1] // _MOMENTS))
    moments = np.arange(1, values.shape[1] + 1) * updates / values.shape[1]
    low, middle, high = np.quantile(values[:, drawn], [0.1, 0.5, 0.9], axis=0)
    axes.fill_between(moments[drawn], low, high, color=colour, alpha=0.2, lw=0, zorder=2)
    axes.plot(moments[drawn], middle, color=colour, ls=dashes, label=label, lw=1.1, zorder=3)


def main() -> None:
    """Learns, measures, draws and writes."""
    arguments = read_arguments(__doc__, seeds=20, scale=1.0)
    learned = tasks(arguments.scale)
    courses = {
        (name, method): learn(task, method, arguments.seeds) for name, task in learned.items() for method in METHODS
    }
    rows = [row for (name, method), course in courses.items() for row in measure(name, method, course)]
    about = "\n".join(describe(name, task) for name, task in learned.items())
    picture = "![Slack and return against updates](violations_on_the_way.png)"
    publish(arguments, "Violations on the way", [_ABOUT, summarise(rows), about, picture], rows)
    if arguments.out is not None:
        write_figure(courses, arguments.out / "violations_on_the_way.png")


if __name__ == "__main__":
    main()
