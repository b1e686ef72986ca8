"""How fast is training beside straight C that does the same work?

The paper's first experiment (three-state MDP, CPGRL by eq. 8–10 with corrected averages, 20 runs × 100 steps an update)

- by `rl.train` with the solver `active-set`: validated, every direction certified, a record for every update;
- by `training_in_c.c`: the same words of the same random stream, the same sums, projections and restorations, and
  nothing else; compiled here, with plain `-O2` and with everything the compiler has for this machine.

Both must reach the same θ to 1e-12, or the benchmark fails: no contender leaves out work.

    python benchmarks/training_in_c.py [--episodes 10000] [--repetitions 15] [--out benchmarks/results]

Limitations: one machine, one process, whatever else it does at the time; compilation is counted for neither. CPU
seconds, repetitions taken in turns; ratios are within a repetition, their median is given.
"""

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from tables import machine, publish, read_arguments, table
from turns import time_in_turns

from cpgrl_opt import ConstrainedStep
from cpgrl_opt.solvers import compile_kernels
from envs import ThreeStateMDP, random_state
from rl import CPGRL, GPOMDP, SoftmaxTable, train, uniform_parameters
from rl.streams import run_streams

RUNS, STEPS, AGREEMENT = 20, 100, 1e-12
SOURCE = Path(__file__).with_suffix(".c")
FLAGS = ("-O2", "-O3 -march=native")
MDP = np.dtype([("rewards", float, (9, 4)), ("next", np.int64, (9, 3))])  # the structures of the C file
RUN = np.dtype([("theta", float, 9), ("rho", float, 4), ("random", np.uint64, 4)])

Training = Callable[[int], np.ndarray]  # episodes → θ (RUNS, 9)


@dataclass(frozen=True)
class Row:
    """One contender's line in the table."""

    method: str
    million_steps_per_second: float  # best repetition
    median_million_steps_per_second: float
    microseconds_per_update: float  # median; RUNS × STEPS steps
    our_rate_as_a_share: float  # of this one's: median over repetitions
    farthest_theta: float  # from ours, max norm


def ours(episodes: int) -> np.ndarray:
    """`rl.train`; nobody looks at its records but the last."""
    learner = CPGRL(ConstrainedStep(step_size=0.02, restoration_rate=0.02), np.zeros(3))
    estimator = GPOMDP(trace_decay=0.99, average_rate=0.02, steps=STEPS)
    parts, initial = (ThreeStateMDP(), SoftmaxTable(3, 3), estimator, learner), uniform_parameters(9)
    records = train(*parts, episodes=episodes, runs=RUNS, initial=initial)
    return deque(records, maxlen=1).pop().parameters


def compiler() -> str:
    """$CC or cc; SystemExit where there is none."""
    name = os.environ.get("CC", "cc")
    if shutil.which(name) is None:
        raise SystemExit(f"{name} should be a C compiler; found none. Install gcc or clang.")
    return name


def in_c(flags: str, folder: Path) -> Training:
    """The C file compiled with these flags."""
    library = folder / f"training{flags.replace(' ', '')}.so"
    subprocess.run([compiler(), *flags.split(), "-shared", "-fPIC", "-o", library, SOURCE, "-lm"], check=True)
    function = ctypes.CDLL(str(library)).train
    kernel, mdp = ThreeStateMDP().finite_kernel(), np.zeros(1, MDP)
    mdp["rewards"] = kernel.rewards.reshape(4, 9).T
    mdp["next"] = np.ceil(kernel.transition_cumulative * 2.0**32).reshape(9, 3)

    def run(episodes: int) -> np.ndarray:
        runs, draw = np.zeros(RUNS, RUN), uniform_parameters(9)
        for index in range(RUNS):
            streams = run_streams(0, index)
            runs["theta"][index] = draw(np.random.default_rng(streams.initial))
            runs["random"][index] = random_state(streams.episodes)
        function(ctypes.c_void_p(mdp.ctypes.data), ctypes.c_void_p(runs.ctypes.data), episodes)
        theta: np.ndarray = runs["theta"]
        return theta

    return run


def measure(episodes: int, repetitions: int) -> list[Row]:
    """Ours first, then C by flags; ValueError where they do not reach the same θ."""
    compile_kernels()
    with tempfile.TemporaryDirectory() as folder:
        contenders = {"rl.train": ours} | {f"C, {flags}": in_c(flags, Path(folder)) for flags in FLAGS}
        works = {method: partial(run, episodes) for method, run in contenders.items()}
        seconds, thetas = time_in_turns(works, repetitions)
    rows = []
    for method, times in seconds.items():
        farthest = float(np.abs(thetas[method] - thetas["rl.train"]).max())
        if not farthest <= AGREEMENT:
            raise ValueError(f"θ of {method} and of rl.train should agree to {AGREEMENT:g}; found {farthest:g}")
        millions = 1e-6 * RUNS * STEPS * episodes / times
        median, share = float(np.median(millions)), float(np.median(times / seconds["rl.train"]))
        rows.append(Row(method, float(millions.max()), median, RUNS * STEPS / median, share, farthest))
    return rows


def main() -> None:
    """Measures, prints and writes."""
    arguments = read_arguments(__doc__, episodes=10_000, repetitions=15)
    rows = measure(arguments.episodes, arguments.repetitions)
    heads = "| | M steps/s | median | µs/update | our rate, as a share of it | θ differs by |"
    line = (
        "| {0.method} | {0.million_steps_per_second:.3g} | {0.median_million_steps_per_second:.3g} | "
        "{0.microseconds_per_update:.3g} | {0.our_rate_as_a_share:.2f} | {0.farthest_theta:.1g} |"
    )
    said = subprocess.run([compiler(), "--version"], check=True, capture_output=True, text=True).stdout.splitlines()[0]
    about = f"Three-state MDP, {RUNS} runs × {STEPS} steps an update, {arguments.episodes} updates. CPU time, best and "
    about += f"median of repetitions taken in turns. {machine()}; {said}."
    publish(arguments, "Training beside straight C", [table(heads, line, rows), about], rows)


if __name__ == "__main__":
    main()
