"""How fast are problems of nine parameters and three constraints, beside a bare QP back end and an uncertified formula?

- A direction: raw arrays → `DirectionProblem` → certified answer of `active-set`; beside it
  `qpsolvers.solve_qp(P, −g, −J, −b, solver="quadprog")`, P ready, which certifies nothing.
- A step of one run: `Linearization` → `ConstrainedStep`, beside the same back end's one QP.
- A batch: certified answers of `active-set` to 10⁴ problems, beside Rosen's formula in NumPy, batched, for equalities
  only, without scaling, rank or certificate: d = g − Jᵀ(JJᵀ)⁻¹Jg.

    python benchmarks/small_problems.py [--repetitions 101] [--batch 10000] [--out benchmarks/results]

CPU seconds, contenders in turns, medians. Limitations: one shape, rows well apart (others take the thorough way: see
`cpgrl compare` for families); one machine and whatever else it does.
"""

import argparse
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from qpsolvers import solve_qp
from tables import machine, table, write
from turns import time_in_turns

from cpgrl_opt import SOLVERS, ConstrainedStep, DirectionProblem, Linearization, ProblemBatch, Status
from cpgrl_opt.solvers import compile_kernels

N, M = 9, 3
SOLVER: Any = SOLVERS["active-set"]


@dataclass(frozen=True)
class Row:
    """One work and what stands beside it; ratio: of their times; bar: the most that it may be; failed: not OPTIMAL."""

    work: str
    microseconds: float
    beside: str
    beside_microseconds: float
    ratio: float
    bar: float
    failed: int

    @property
    def verdict(self) -> str:
        """Of the bar."""
        return "kept" if self.ratio <= self.bar else "missed"


def batched_rosen(g: np.ndarray, J: np.ndarray) -> np.ndarray:
    """d = g − Jᵀ(JJᵀ)⁻¹Jg of each problem."""
    weights = np.linalg.solve(J @ J.swapaxes(1, 2), J @ g[:, :, None])
    tangents: np.ndarray = g - (weights.swapaxes(1, 2) @ J)[:, 0]
    return tangents


def measure_works(works: dict[str, Callable[[], Any]], repetitions: int, calls: int) -> dict[str, float]:
    """Median CPU microseconds of a call."""

    def repeat(work: Callable[[], Any], times: int) -> None:
        for _ in range(times):
            work()

    for work in works.values():
        repeat(work, 30 if calls > 1 else 1)  # compiles, and fills the caches
    seconds, _ = time_in_turns({name: partial(repeat, work, calls) for name, work in works.items()}, repetitions)
    return {name: 1e6 * statistics.median(times) / calls for name, times in seconds.items()}


def measure_one(repetitions: int) -> list[Row]:
    """A direction and steps beside quadprog."""
    rng = np.random.default_rng(0)
    A, b, P = rng.normal(size=(1 + M, N)), np.zeros(M), np.eye(N)
    g, J, values, thresholds = A[0], A[1:], np.array([0.0, -0.1, -0.2, 0.3]), np.zeros(M)
    steps = {name: ConstrainedStep(formulation=name) for name in ("restoring", "equality")}
    works: dict[str, Callable[[], Any]] = {
        "quadprog": partial(solve_qp, P, -g, -J, -b, solver="quadprog"),
        "direction": lambda: SOLVER.solve(DirectionProblem(g, J, b)),
        "restoring": lambda: steps["restoring"](Linearization(values, A), thresholds),
        "equality": lambda: steps["equality"](Linearization(values, A), thresholds),
    }
    times = measure_works(works, repetitions, calls=100)
    failed = int(works["direction"]().status != Status.OPTIMAL)
    bars = {"direction": 1 / 1.7, "restoring": 1.0, "equality": 1.3}
    beside = times["quadprog"]
    return [Row(name, times[name], "quadprog", beside, times[name] / beside, bar, failed) for name, bar in bars.items()]


def measure_batch(repetitions: int, count: int) -> Row:
    """A certified batch beside an uncertified formula."""
    rng = np.random.default_rng(1)
    g, J = rng.normal(size=(count, N)), rng.normal(size=(count, M, N))
    problems = ProblemBatch(g, J)
    works = {"batch": lambda: SOLVER.solve_batch(problems), "rosen": lambda: batched_rosen(g, J)}
    times = measure_works(works, repetitions, calls=1)
    failed = int(np.count_nonzero(SOLVER.solve_batch(problems).status))
    ours, beside = times["batch"] / count, times["rosen"] / count
    return Row(f"batch of {count}", ours, "NumPy's batched Rosen", beside, ours / beside, 1 / 0.8, failed)


def page(rows: list[Row]) -> str:
    """The table."""
    heads = "| work | µs | beside it | µs | ratio | bar | |"
    line = (
        "| {0.work} | {0.microseconds:.3g} | {0.beside} | {0.beside_microseconds:.3g} | {0.ratio:.2f} | "
        "≤ {0.bar:.2f} | {0.verdict} |"
    )
    return (
        f"# Problems of ({N}, {M})\n\n{table(heads, line, rows)}\n\nCPU time, medians, in turns; of a batch a "
        f"problem's. Failures: {sum(row.failed for row in rows)}. {machine()}. "
        "Command: `OMP_NUM_THREADS=1 python benchmarks/small_problems.py`.\n"
    )


def main() -> None:
    """Measures, prints and writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=101)
    parser.add_argument("--batch", type=int, default=10_000)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    arguments = parser.parse_args()
    compile_kernels()
    rows = [*measure_one(arguments.repetitions), measure_batch(max(arguments.repetitions // 5, 1), arguments.batch)]
    print(page(rows))
    write("small_problems", page(rows), rows, arguments.out)


if __name__ == "__main__":
    main()
