"""How many environment steps per second does training make, and how far is that from NumPy?

The paper's first experiment (three-state MDP, CPGRL by eq. 8–10, 20 runs × 10000 episodes × 100 steps) trained by

- `rl.train`, compiled, with the solvers `rosen` and `active-set`;
- an academic loop: one run after the other, eq. 3–10 line by line in NumPy, as one would write it first;
- NumPy over the runs: the same, 20 runs in lockstep in every array operation.

The two in NumPy live below. Each contender trains fewer episodes than the paper, the slow ones
fewer than the fast; the minutes at full size are extrapolated, time per step being constant. Accuracy beside time: the
exact g¹ and the least slack of the policies reached (after different numbers of episodes; after equally many the
contenders agree within noise, which a test checks).

    python benchmarks/training_speed.py [--scale 10] [--out benchmarks/results]

Limitations: one machine, one process, whatever else it does at the time; compilation is not counted, nor are records
written. CPU seconds; the best of nine repetitions taken in turns, since neighbours on the machine only ever slow down,
and their median beside it.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from tables import machine, publish, read_arguments, table
from turns import time_in_turns

from cpgrl_opt import ConstrainedStep
from cpgrl_opt.solvers import compile_kernels
from envs import ThreeStateMDP
from rl import CPGRL, GPOMDP, SoftmaxTable, train, uniform_parameters

RUNS, STEPS, FULL, REPETITIONS = 20, 100, 20 * 10_000 * 100, 9
BETA, ALPHA_R, ALPHA = 0.99, 0.02, 0.02
MDP = ThreeStateMDP()


@dataclass(frozen=True)
class Row:
    """One contender's line in the table."""

    method: str
    runs: int
    episodes: int
    million_steps_per_second: float
    median_million_steps_per_second: float
    microseconds_per_step: float
    full_size_seconds: float  # extrapolated
    ratio_to_academic: float
    g1: float  # exact, mean over runs, after these episodes
    least_slack: float  # exact, over runs and constraints


def compiled(solver: str, runs: int, episodes: int) -> np.ndarray:
    """`rl.train` with this solver; θ (runs, 9)."""
    learner = CPGRL(ConstrainedStep(solver=solver, step_size=ALPHA, restoration_rate=ALPHA), np.zeros(3))
    estimator = GPOMDP(trace_decay=BETA, average_rate=ALPHA_R, steps=STEPS)
    parts, initial = (MDP, SoftmaxTable(3, 3), estimator, learner), uniform_parameters(9)
    return deque(train(*parts, episodes=episodes, runs=runs, initial=initial), maxlen=1).pop().parameters


def academic(runs: int, episodes: int) -> np.ndarray:
    """One run after the other, step by step, as eq. 3–10 are printed."""
    rng, finals = np.random.default_rng(0), []
    for _ in range(runs):
        theta, rho = rng.random((3, 3)), np.zeros(4)
        for _ in range(episodes):
            z, delta, psi = np.zeros((3, 3)), np.zeros((4, 3, 3)), np.zeros((3, 3))
            x = MDP.start
            for t in range(STEPS):
                mu = np.exp(theta[x]) / np.exp(theta[x]).sum()
                u = rng.choice(3, p=mu)
                if t > 0:
                    z = BETA * z + psi
                psi = np.zeros((3, 3))
                psi[x] = -mu
                psi[x, u] += 1
                if t > 0:
                    r = MDP.rewards[:, x, u]
                    delta += (r[:, None, None] * (z + psi) - delta) / t  # eq. 3
                    rho += ALPHA_R * (r - rho)  # eq. 4
                x = rng.choice(3, p=MDP.transitions[x, u])
            theta += projected_step(rho, delta.reshape(4, 9)).reshape(3, 3)
        finals.append(theta.reshape(9))
    return np.array(finals)


def projected_step(rho: np.ndarray, delta: np.ndarray) -> np.ndarray:
    """α₁PΔ¹ − αₑd by the pseudo-inverse of NᵀN, eq. 8–10."""
    active = rho[1:] <= 0
    N = delta[1:][active].T
    inverse = np.linalg.pinv(N.T @ N)
    P, d = np.eye(9) - N @ inverse @ N.T, N @ inverse @ rho[1:][active]
    change: np.ndarray = ALPHA * (P @ delta[0] - d)
    return change


def vectorised(runs: int, episodes: int) -> np.ndarray:
    """All runs at once in every array operation, one step after the other."""
    rng, rows = np.random.default_rng(0), np.arange(runs)
    theta, rho = rng.random((runs, 3, 3)), np.zeros((runs, 4))
    transitions, rewards = MDP.transitions.cumsum(axis=2), MDP.rewards.transpose(1, 2, 0)
    for _ in range(episodes):
        mu = np.exp(theta)
        mu /= mu.sum(axis=2, keepdims=True)
        cumulative, draws = mu.cumsum(axis=2), rng.random((STEPS, 2, runs))
        z, psi, total = np.zeros((runs, 3, 3)), np.zeros((runs, 3, 3)), np.zeros((runs, 4, 9))
        x = np.full(runs, MDP.start)
        for t in range(STEPS):
            u = (draws[t, 0, :, None] >= cumulative[rows, x, :2]).sum(axis=1)
            if t > 0:
                z = BETA * z + psi
            psi = np.zeros((runs, 3, 3))
            psi[rows, x] = -mu[rows, x]
            psi[rows, x, u] += 1
            if t > 0:
                r = rewards[x, u]
                total += r[:, :, None] * (z + psi).reshape(runs, 1, 9)
                rho += ALPHA_R * (r - rho)
            x = (draws[t, 1, :, None] >= transitions[x, u, :2]).sum(axis=1)
        delta = total / (STEPS - 1)
        theta += np.array([projected_step(*pair) for pair in zip(rho, delta, strict=True)]).reshape(runs, 3, 3)
    return theta.reshape(runs, 9)


# (runs, episodes) → θ; runs, and episodes at scale 1. The academic loop, first, makes two runs, for its time per step
# does not depend on their number.
CONTENDERS: dict[str, tuple[Callable[[int, int], np.ndarray], int, int]] = {
    "academic NumPy loop": (academic, 2, 25),
    "NumPy over the runs": (vectorised, RUNS, 100),
    "rl.train, rosen": (partial(compiled, "rosen"), RUNS, 1000),
    "rl.train, active-set": (partial(compiled, "active-set"), RUNS, 1000),
}


def measure(scale: float) -> list[Row]:
    """Every contender, `scale` times its usual number of episodes; the repetitions are taken in turns."""
    compile_kernels()
    sizes = {method: (runs, max(int(usual * scale), 1)) for method, (_, runs, usual) in CONTENDERS.items()}
    works = {method: partial(run, *sizes[method]) for method, (run, _, _) in CONTENDERS.items()}
    seconds, thetas = time_in_turns(works, REPETITIONS)
    rows = []
    for method, (runs, episodes) in sizes.items():
        per_step = seconds[method] / (runs * episodes * STEPS)
        best, rates = float(per_step.min()), 1e-6 / per_step
        g = MDP.average_rewards(SoftmaxTable(3, 3).probabilities(thetas[method]))
        speed = float(rates.max()), float(np.median(rates)), 1e6 * best, best * FULL
        ratio = rows[0].microseconds_per_step / speed[2] if rows else 1.0
        rows.append(Row(method, runs, episodes, *speed, ratio, float(g[:, 0].mean()), float(g[:, 1:].min())))
    return rows


def main() -> None:
    """Measures, prints and writes."""
    arguments = read_arguments(__doc__, scale=1.0)
    rows = measure(arguments.scale)
    heads = "| | M steps/s | median | µs/step | full size, s | × academic | runs × episodes | g¹ | least slack |"
    line = (
        "| {0.method} | {0.million_steps_per_second:.3g} | {0.median_million_steps_per_second:.3g} | "
        "{0.microseconds_per_step:.3g} | {0.full_size_seconds:.1f} | {0.ratio_to_academic:.3g} | {0.runs} × "
        "{0.episodes:d} | {0.g1:.2f} | {0.least_slack:.3f} |"
    )
    about = (
        "Full size, 20 runs × 10000 episodes × 100 steps a method, is extrapolated from the steps measured. CPU time, "
    )
    about += f"best of {REPETITIONS}; their median beside it. {machine()}."
    publish(arguments, "Training speed", [table(heads, line, rows), about], rows)


if __name__ == "__main__":
    main()
