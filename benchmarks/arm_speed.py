"""How many steps of the two-link arm does one core make per second, and where does the time go?

Goal: 0.7 million environment steps per second of one core in training. Measured, at the settings of the experiment
(`rl.experiments.arm`: Konda's actor-critic, 40 basis functions, 3 critics, 20 runs in lockstep):

- estimation alone at θ = 0: the arm, the policy, the critics, but no update of θ;
- training from θ = 0 under conditions of the paper, the projected step after each episode with it. A step costs the
  same whatever the condition; the update after an episode is shared by the steps of that episode, which get fewer as
  (c) learns to touch at once;
- the generic path: the same estimator through Gymnasium's `step`, in Python.

    python benchmarks/arm_speed.py [--scale 1] [--out benchmarks/results]

Limitations: one machine, one process, whatever else it does at the time; compilation is not counted, nor are records
written. CPU seconds; the best of three repetitions taken in turns, since neighbours on the machine only ever slow down.
The arm's episodes end by chance, so contenders differ in length of episode as well as in speed.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from tables import machine, table, write
from turns import time_in_turns

from cpgrl_opt.solvers import compile_kernels
from envs import TwoLinkArm
from rl import train
from rl.estimators import Estimate
from rl.experiments.arm import ArmExperiment, arm_policy
from rl.streams import run_streams

GOAL = 0.7  # million steps per second
ARM = TwoLinkArm()


@dataclass(frozen=True)
class Row:
    """One contender's line in the table."""

    method: str
    runs: int
    episodes: int
    million_steps_per_second: float
    microseconds_per_step: float
    ratio_to_goal: float
    steps_per_episode: float
    milliseconds_per_episode: float  # of all runs together


def estimation(estimator: str, environment: Callable[[], Any]) -> Callable[[int, int], Iterator[Estimate]]:
    """Episodes at θ = 0; (runs, episodes) → estimates."""

    def run(runs: int, episodes: int) -> Iterator[Estimate]:
        settings, policy = ArmExperiment(estimator=estimator), arm_policy(ARM)
        streams = [run_streams(0, index).episodes for index in range(runs)]
        under_way = settings.gradient_estimator("a").start(environment(), policy, streams)
        for _ in range(episodes):
            yield under_way.episode(np.zeros((runs, len(policy.parameters))))

    return run


def training(condition: str) -> Callable[[int, int], Iterator[Estimate]]:
    """`rl.train` under a condition of the experiment, from θ = 0."""

    def run(runs: int, episodes: int) -> Iterator[Estimate]:
        settings = ArmExperiment(conditions=(condition,))
        (case,) = settings.cases()
        estimator, learner = settings.gradient_estimator(condition), settings.learner(case)
        for record in train(ARM, arm_policy(ARM), estimator, learner, episodes=episodes, runs=runs):
            yield record.estimate

    return run


# runs, and episodes at scale 1
CONTENDERS: dict[str, tuple[Callable[[int, int], Iterator[Estimate]], int, int]] = {
    "estimation, Konda": (estimation("konda", lambda: ARM), 20, 100),
    "estimation, GPOMDP": (estimation("gpomdp", lambda: ARM), 20, 100),
    "training, (a) no constraints": (training("a"), 20, 300),
    "training, (b) G² = G³ = 0": (training("b"), 20, 300),
    "training, (c) G² = 0, G³ = 0.5": (training("c"), 20, 300),
    "training, (c), ten times as long": (training("c"), 20, 3000),
    "generic path, Konda": (estimation("konda", lambda: gymnasium.make("cpgrl/TwoLinkArm-v0")), 1, 10),
}


def measure(scale: float = 1.0, repetitions: int = 3) -> list[Row]:
    """Every contender, `scale` times its usual number of episodes; the best of the repetitions, taken in turns."""
    compile_kernels()
    for run, runs, _ in CONTENDERS.values():
        list(run(runs, 1))  # compiles, or loads from the cache
    sizes = {method: (runs, max(int(usual * scale), 1)) for method, (_, runs, usual) in CONTENDERS.items()}
    works = {method: partial(steps_of, run, *sizes[method]) for method, (run, _, _) in CONTENDERS.items()}
    seconds, steps = time_in_turns(works, repetitions)
    return [row_of(method, min(seconds[method]), steps[method], *sizes[method]) for method in CONTENDERS]


def steps_of(run: Callable[[int, int], Iterator[Estimate]], runs: int, episodes: int) -> int:
    """How many steps its episodes have."""
    return sum(int(estimate.steps.sum()) for estimate in run(runs, episodes))


def row_of(method: str, seconds: float, steps: int, runs: int, episodes: int) -> Row:
    """The line of a method that made so many steps in so many seconds."""
    return Row(
        method=method,
        runs=runs,
        episodes=episodes,
        million_steps_per_second=1e-6 * steps / seconds,
        microseconds_per_step=1e6 * seconds / steps,
        ratio_to_goal=1e-6 * steps / seconds / GOAL,
        steps_per_episode=steps / (runs * episodes),
        milliseconds_per_episode=1e3 * seconds / episodes,
    )


def report(rows: list[Row]) -> str:
    """The table with what it was measured on."""
    heads = "| | M steps/s | µs/step | × goal | steps/episode | ms/episode of all runs | runs × episodes |"
    line = (
        "| {0.method} | {0.million_steps_per_second:.3g} | {0.microseconds_per_step:.3g} | {0.ratio_to_goal:.2g} | "
        "{0.steps_per_episode:.0f} | {0.milliseconds_per_episode:.2f} | {0.runs} × {0.episodes:d} |"
    )
    return (
        f"# Speed on the two-link arm\n\n{table(heads, line, rows)}\n\nGoal: {GOAL} million "
        f"steps per second of one core in training. One process on {machine()}; CPU time, best of three. "
        f"Command: `python benchmarks/arm_speed.py --out benchmarks/results`.\n"
    )


def main() -> None:
    """Measure, print, and write when asked to."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scale", type=float, default=1.0, help="times the usual number of episodes (1: a minute)")
    parser.add_argument("--out", type=Path, help="folder for arm_speed.csv and arm_speed.md")
    arguments = parser.parse_args()
    rows = measure(arguments.scale)
    print(report(rows))
    write("arm_speed", report(rows), rows, arguments.out)


if __name__ == "__main__":
    main()
