"""How long do new processes take: to the first direction, to the first episode, for whole commands, cold and warm?

Each measurement is a process of its own, from its start to its end, by the wall clock; beside it the processor's time,
which neighbours on the machine lengthen less. Cold: numba's cache is a new
folder, so every kernel that is met is compiled; warm: the same folder once more. Beside them stands what numba takes
for itself: a process that loads one function of one line from the cache, and calls it; a first episode may take half a
second more.

    python benchmarks/startup.py [--repeats 5] [--without-commands] [--out benchmarks/results]

Limitations: one machine, whatever else it does at the time; cold ones once or twice, warm ones `repeats` times, the
best and the median. Files are in the system's cache, since the process before has read them.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tables import machine, table, write

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
LINE = "| {0.what} | {0.cache} | {0.goal:.3g} | {0.best:.2f} | {0.median:.2f} | {0.cpu:.2f} | {0.repeats:d} |"


@dataclass(frozen=True)
class Row:
    """Seconds of one kind of process; goal: from the project's requirements, 0 where there is none."""

    what: str
    cache: str
    goal: float
    best: float
    median: float
    cpu: float  # best; of the process and its own children
    repeats: int


def measure(repeats: int, folder: Path, *, commands: bool) -> list[Row]:
    """Every kind of process, the cold one first."""
    (folder / "one_line.py").write_text(ONE_LINE, encoding="utf-8")
    floor = [sys.executable, "-c", FLOOR]
    rows = pair("numba itself: one cached function of one line", floor, folder, goals=(0.0, 0.0), repeats=(2, repeats))
    programs = [
        ("first direction, active-set", SOLVE, 10.0, 0.3),
        ("first direction, of an infeasible problem", INFEASIBLE, 10.0, 0.3),
        ("first step, whose kernels are compiled", STEP, 10.0, 0.0),
        ("first episode of training", EPISODE, 30.0, rows[-1].median + 0.5),
    ]
    for what, program, cold, warm in programs:
        rows += pair(what, [sys.executable, "-c", program], folder, goals=(cold, warm), repeats=(2, repeats))
    if commands:
        cpgrl = [sys.executable, "-m", "rl.cli"]
        reproduce = [*cpgrl, "reproduce", "three-state", "--out", str(folder / "three-state")]
        rows += pair("cpgrl reproduce three-state", reproduce, folder, goals=(30.0, 10.0), repeats=(1, 3))
        compare = [*cpgrl, "compare", "--quick", "--anew", "--out", str(folder / "compare")]
        rows += pair("cpgrl compare --quick", compare, folder, goals=(0.0, 60.0), repeats=(0, 1))
    return rows


def pair(
    what: str, command: Sequence[str], folder: Path, *, goals: tuple[float, float], repeats: tuple[int, int]
) -> list[Row]:
    """A row for a cold cache and one for a warm one."""
    rows = []
    with tempfile.TemporaryDirectory(dir=folder) as cache:
        cold = []
        for _ in range(repeats[0]):
            with tempfile.TemporaryDirectory(dir=folder) as fresh:
                cold.append(seconds(command, folder, fresh))
        seconds(command, folder, cache)
        warm = [seconds(command, folder, cache) for _ in range(repeats[1])]
    for name, goal, times in (("cold", goals[0], cold), ("warm", goals[1], warm)):
        if times:
            wall, cpu = zip(*times, strict=True)
            numbers = (round(number, 2) for number in (min(wall), statistics.median(wall), min(cpu)))
            rows.append(Row(what, name, goal, *numbers, len(times)))
            print(LINE.format(rows[-1]), flush=True)
    return rows


def seconds(command: Sequence[str], folder: Path, cache: str) -> tuple[float, float]:
    """Wall and CPU seconds of the process; CalledProcessError with what it said if it fails."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": cache, "PYTHONPATH": path(folder)}
    start, before = time.perf_counter(), os.times()
    subprocess.run(command, env=environment, check=True, capture_output=True, cwd=folder)
    wall, after = time.perf_counter() - start, os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return wall, used


def path(folder: Path) -> str:
    """Where processes look for modules: the folder of these, then wherever this one looks."""
    return os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH", "")])])


def page(rows: Sequence[Row]) -> str:
    """The table with what it was measured on."""
    heads = "| process | numba's cache | goal (0: none) | best | median | CPU | of |"
    return (
        "# New processes, cold and warm\n\nWall seconds of a whole process, and CPU seconds (best). "
        "Command: `python benchmarks/startup.py --out benchmarks/results`.\n\n"
        f"{table(heads, LINE, rows)}\n\n{os.cpu_count()} cores, {machine()}.\n"
    )


def main() -> None:
    """Measure, print, and write when asked to."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--without-commands", action="store_true", help="leave out whole commands, two minutes")
    parser.add_argument("--out", type=Path, help="folder for startup.csv and startup.md")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = measure(arguments.repeats, Path(folder), commands=not arguments.without_commands)
    write("startup", page(rows), rows, arguments.out)


if __name__ == "__main__":
    main()
