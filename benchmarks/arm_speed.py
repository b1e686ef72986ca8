"""How many steps of the two-link arm does one core make per second, and where does the time go?

Goal: 0.7 million environment steps per second of one core in training. Measured, at the settings of the experiment
(`rl.experiments.arm`: Konda's actor-critic, 40 basis functions, 3 critics, 20 runs in lockstep):

- estimation alone at θ = 0: the arm, the policy, the critics, but no update of θ;
- training from θ = 0 under conditions of the paper, the projected step after each episode with it. A step costs the
  same whatever the condition; the update after an episode is shared by the steps of that episode, which get fewer as
  (c) learns to touch at once;
- the generic path: the same estimator through Gymnasium's `step`, in Python.

    python benchmarks/arm_speed.py [--scale 1] [--out benchmarks/results]

--scale: times the usual number of episodes. Limitations: one machine, one process, whatever else it does at the time;
compilation is not counted, nor are records written. CPU seconds; the best of three repetitions taken in turns, since
neighbours on the machine only ever slow down. The arm's episodes end by chance, so contenders differ in length of
episode as well as in speed.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from tables import machine, publish, read_arguments, table
from turns import time_in_turns

from cpgrl_opt.solvers import compile_kernels
from envs import TwoLinkArm
from rl import train
from rl.estimators import Estimate
from rl.experiments.arm import ArmExperiment, arm_policy
from rl.streams import run_streams

GOAL, REPETITIONS = 0.7, 3  # million steps per second
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


def estimate(estimator: str, environment: Callable[[], Any], runs: int, episodes: int) -> Iterator[Estimate]:
    """Episodes at θ = 0."""
    settings, policy = ArmExperiment(estimator=estimator), arm_policy(ARM)
    streams = [run_streams(0, index).episodes for index in range(runs)]
    under_way = settings.gradient_estimator("a").start(environment(), policy, streams)
    for _ in range(episodes):
        yield under_way.episode(np.zeros((runs, len(policy.parameters))))


def learn(condition: str, runs: int, episodes: int) -> Iterator[Estimate]:
    """`rl.train` under a condition of the experiment, from θ = 0."""
    settings = ArmExperiment(conditions=(condition,))
    (case,) = settings.cases()
    estimator, learner = settings.gradient_estimator(condition), settings.learner(case)
    for record in train(ARM, arm_policy(ARM), estimator, learner, episodes=episodes, runs=runs):
        yield record.estimate


# (runs, episodes) → estimates; runs, and episodes at scale 1
CONTENDERS: dict[str, tuple[Callable[[int, int], Iterator[Estimate]], int, int]] = {
    "estimation, Konda": (partial(estimate, "konda", lambda: ARM), 20, 100),
    "estimation, GPOMDP": (partial(estimate, "gpomdp", lambda: ARM), 20, 100),
    "training, (a) no constraints": (partial(learn, "a"), 20, 300),
    "training, (b) G² = G³ = 0": (partial(learn, "b"), 20, 300),
    "training, (c) G² = 0, G³ = 0.5": (partial(learn, "c"), 20, 300),
    "training, (c), ten times as long": (partial(learn, "c"), 20, 3000),
    "generic path, Konda": (partial(estimate, "konda", lambda: gymnasium.make("cpgrl/TwoLinkArm-v0")), 1, 10),
}


def count_steps(run: Callable[[int, int], Iterator[Estimate]], runs: int, episodes: int) -> int:
    """How many steps its episodes have."""
    return sum(int(estimate.steps.sum()) for estimate in run(runs, episodes))


def measure(scale: float) -> list[Row]:
    """Every contender, `scale` times its usual number of episodes; the best of the repetitions."""
    compile_kernels()
    sizes = {method: (runs, max(int(usual * scale), 1)) for method, (_, runs, usual) in CONTENDERS.items()}
    works = {method: partial(count_steps, run, *sizes[method]) for method, (run, _, _) in CONTENDERS.items()}
    seconds, counts = time_in_turns(works, REPETITIONS)
    rows = []
    for method, (runs, episodes) in sizes.items():
        best, steps = float(seconds[method].min()), counts[method]
        rate = 1e-6 * steps / best
        lengths = steps / (runs * episodes), 1e3 * best / episodes
        rows.append(Row(method, runs, episodes, rate, 1 / rate, rate / GOAL, *lengths))
    return rows


def main() -> None:
    """Measures, prints and writes."""
    arguments = read_arguments(__doc__, scale=1.0)
    rows = measure(arguments.scale)
    heads = "| | M steps/s | µs/step | × goal | steps/episode | ms/episode of all runs | runs × episodes |"
    line = (
        "| {0.method} | {0.million_steps_per_second:.3g} | {0.microseconds_per_step:.3g} | {0.ratio_to_goal:.2g} | "
        "{0.steps_per_episode:.0f} | {0.milliseconds_per_episode:.2f} | {0.runs} × {0.episodes:d} |"
    )
    about = f"Goal: {GOAL} million steps per second of one core in training. CPU time, best of {REPETITIONS}."
    publish(arguments, "Speed on the two-link arm", [table(heads, line, rows), f"{about} {machine()}."], rows)


if __name__ == "__main__":
    main()
