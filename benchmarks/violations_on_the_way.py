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

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tables import write
from violations_figure import write_figure
from violations_page import page

from cpgrl_opt import ConstrainedStep
from envs import GridWorld, TwoLinkArm
from rl.estimators import GPOMDP, ExactGradient, GradientEstimator, KondaActorCritic
from rl.experiments.arm.experiment import MAX_CHANGE, arm_policy
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


def main() -> None:
    """Learns, measures, draws and writes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    arguments = parser.parse_args()
    learned = tasks(arguments.scale)
    courses = {
        (name, method): learn(task, method, arguments.seeds) for name, task in learned.items() for method in METHODS
    }
    rows = [row for (name, method), course in courses.items() for row in measure(name, method, course)]
    text = page(rows, learned, f"--seeds {arguments.seeds} --scale {arguments.scale:g}")
    print(text)
    write("violations_on_the_way", text, rows, arguments.out)
    write_figure(courses, arguments.out / "violations_on_the_way.png")


if __name__ == "__main__":
    main()
