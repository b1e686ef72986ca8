"""How long do new processes take: to the first direction, to the first episode, for whole commands, cold and warm?

Each measurement is a process of its own, from its start to its end, by the wall clock; beside it the processor's time,
which neighbours on the machine lengthen less. Cold: numba's cache is a new folder, so every kernel that is met is
compiled; warm: the same folder once more. Beside them stands what numba takes for itself: a process that loads one
function of one line from the cache, and calls it; a first episode may take half a second more.

    python benchmarks/startup.py [--repeats 5] [--without-commands] [--out benchmarks/results]

Our files are compiled to Python's bytecode before anything is timed, as pip does at an installation. Without it, where
PYTHONDONTWRITEBYTECODE is set, each process would compile 80 files first: 0.17 s.

Limitations: one machine, whatever else it does at the time; cold ones once or twice, warm ones `repeats` times, the
best and the median; whole commands, two minutes, not with --without-commands. Files are in the system's cache, since
the process before has read them.
"""

import compileall
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
from tables import machine, publish, read_arguments, table

SOLVE = """
from cpgrl_opt import SOLVERS, DirectionProblem
SOLVERS["active-set"].solve(DirectionProblem([1.0, 2.0, 3.0], [[1.0, 0.0, 0.0], [0.0, 1.0, -1.0]], [0.0, 0.1]))
"""
INFEASIBLE = """
from cpgrl_opt import SOLVERS, DirectionProblem
SOLVERS["active-set"].solve(DirectionProblem([1.0, 2.0], [[1.0, 0.0], [-1.0, 0.0]], [1.0, 1.0]))
"""
STEP = """
from cpgrl_opt import ConstrainedStep, Linearization
ConstrainedStep()(Linearization([0.0, -1.0], [[1.0, 2.0, 3.0], [1.0, 0.0, 0.0]]), [0.0])
"""
EPISODE = """
from cpgrl_opt import ConstrainedStep
from envs import ThreeStateMDP
from rl import CPGRL, GPOMDP, SoftmaxTable, train
learner = CPGRL(ConstrainedStep(solver="active-set"), [0.0, 0.0, 0.0])
next(train(ThreeStateMDP(), SoftmaxTable(3, 3), GPOMDP(), learner, episodes=1))
"""
FLOOR = """
import numpy, one_line
one_line.first(numpy.ones(3))
"""
ONE_LINE = """
from numba import njit
@njit("float64(float64[::1])", cache=True)
def first(x):
    return x[0]
"""
PROGRAMS = {
    "first direction, active-set": (SOLVE, 10.0, 0.3),
    "first direction, of an infeasible problem": (INFEASIBLE, 10.0, 0.3),
    "first step, whose kernels are compiled": (STEP, 10.0, None),
    "first episode of training": (EPISODE, 30.0, None),
}
COLD = 2  # processes with an empty cache
PACKAGES = ("cpgrl_opt", "rl", "envs")
CPGRL = [sys.executable, "-m", "rl.cli"]


@dataclass(frozen=True)
class Row:
    """Seconds of one kind of process; goal: from the project's requirements, None where there is none."""

    what: str
    cache: str
    goal: float | None
    best: float
    median: float
    cpu: float  # best; of the process and its own children
    repeats: int


def measure(repeats: int, folder: Path, *, commands: bool) -> list[Row]:
    """Every kind of process, the cold one first."""
    for package in PACKAGES:
        compileall.compile_dir(files(package), quiet=2)
    (folder / "one_line.py").write_text(ONE_LINE, encoding="utf-8")
    floor, goals = [sys.executable, "-c", FLOOR], (None, None)
    rows = time_pair("numba itself: one cached function of one line", floor, folder, goals, (COLD, repeats))
    for what, (program, cold, warm) in PROGRAMS.items():
        goal = rows[1].median + 0.5 if program is EPISODE else warm  # half a second above numba itself
        rows += time_pair(what, [sys.executable, "-c", program], folder, (cold, goal), (COLD, repeats))
    if commands:
        reproduce = [*CPGRL, "reproduce", "three-state", "--out", str(folder / "three-state")]
        rows += time_pair("cpgrl reproduce three-state", reproduce, folder, (30.0, 10.0), (1, 3))
        compare = [*CPGRL, "compare", "--quick", "--anew", "--out", str(folder / "compare")]
        rows += time_pair("cpgrl compare --quick", compare, folder, (None, 60.0), (0, 1))
    return rows


def time_pair(
    what: str, command: Sequence[str], folder: Path, goals: tuple[float | None, ...], repeats: tuple[int, int]
) -> list[Row]:
    """A row for cold caches and one for a warm one, of so many processes each."""
    cold = []
    for _ in range(repeats[0]):
        with tempfile.TemporaryDirectory(dir=folder) as fresh:
            cold.append(time_process(command, folder, fresh))
    with tempfile.TemporaryDirectory(dir=folder) as cache:
        warm = [time_process(command, folder, cache) for _ in range(1 + repeats[1])][1:]
    rows = []
    for name, goal, times in (("cold", goals[0], cold), ("warm", goals[1], warm)):
        if times:
            wall, cpu = np.array(times).T
            seconds = (round(float(each), 2) for each in (wall.min(), np.median(wall), cpu.min()))
            rows.append(Row(what, name, goal, *seconds, len(times)))
    return rows


def time_process(command: Sequence[str], folder: Path, cache: str) -> tuple[float, float]:
    """Wall and CPU seconds of the process; CalledProcessError with what it said if it fails."""
    path = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH", "")])])
    environment = {**os.environ, "NUMBA_CACHE_DIR": cache, "PYTHONPATH": path}
    start, before = time.perf_counter(), os.times()
    subprocess.run(command, env=environment, check=True, capture_output=True, cwd=folder)
    wall, after = time.perf_counter() - start, os.times()
    return wall, after.children_user + after.children_system - before.children_user - before.children_system


def main() -> None:
    """Measures, prints and writes."""
    arguments = read_arguments(__doc__, repeats=5, without_commands=False)
    with tempfile.TemporaryDirectory() as folder:
        rows = measure(arguments.repeats, Path(folder), commands=not arguments.without_commands)
    heads = "| process | numba's cache | goal | best | median | CPU | of |"
    line = "| {0.what} | {0.cache} | {0.goal} | {0.best:.2f} | {0.median:.2f} | {0.cpu:.2f} | {0.repeats:d} |"
    lines = table(heads, line, rows).replace("| None |", "| |")  # where no goal is set
    about = "Wall seconds of a whole process, and CPU seconds (best)."
    publish(arguments, "New processes, cold and warm", [about, lines, f"{machine()}."], rows)


if __name__ == "__main__":
    main()
