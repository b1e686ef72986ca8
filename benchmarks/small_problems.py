"""How fast are problems of nine parameters and three constraints, beside a bare QP back end and an uncertified formula?

- A direction: raw arrays → `DirectionProblem` → certified answer of `active-set`; beside it
  `qpsolvers.solve_qp(P, −g, −J, −b, solver="quadprog")`, P ready, which certifies nothing.
- A step of one run: `Linearization` → `ConstrainedStep`, beside the same back end's one QP.
- A batch: certified answers of `active-set` to 10⁴ problems, beside Rosen's formula in NumPy, batched, for equalities
  only, without scaling, rank or certificate: d = g − Jᵀ(JJᵀ)⁻¹Jg.

    OMP_NUM_THREADS=1 python benchmarks/small_problems.py [--repetitions 101] [--batch 10000] [--out benchmarks/results]

CPU seconds, contenders in turns, medians. Limitations: one shape, rows well apart (others take the thorough way: see
`cpgrl compare` for families); one machine and whatever else it does.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from qpsolvers import solve_qp
from tables import machine, publish, read_arguments, table, verdict
from turns import time_in_turns

from cpgrl_opt import SOLVERS, ConstrainedStep, DirectionProblem, Linearization, ProblemBatch, Status
from cpgrl_opt.solvers import compile_kernels

N, M, CALLS = 9, 3, 100
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
        return verdict(self.ratio, self.bar)


def batched_rosen(g: np.ndarray, J: np.ndarray) -> np.ndarray:
    """d = g − Jᵀ(JJᵀ)⁻¹Jg of each problem."""
    weights = np.linalg.solve(J @ J.swapaxes(1, 2), J @ g[:, :, None])
    tangents: np.ndarray = g - (weights.swapaxes(1, 2) @ J)[:, 0]
    return tangents


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
    times, results = time_in_turns(works, repetitions, CALLS)
    failed = int(results["direction"].status != Status.OPTIMAL)
    bars = {"direction": 1 / 1.7, "restoring": 1.0, "equality": 1.3}
    return [compare(work, times[work], "quadprog", times["quadprog"], bar, failed) for work, bar in bars.items()]


def measure_batch(repetitions: int, count: int) -> Row:
    """A certified batch beside an uncertified formula."""
    rng = np.random.default_rng(1)
    g, J = rng.normal(size=(count, N)), rng.normal(size=(count, M, N))
    problems = ProblemBatch(g, J)
    works = {"batch": lambda: SOLVER.solve_batch(problems), "rosen": lambda: batched_rosen(g, J)}
    times, results = time_in_turns(works, repetitions)
    failed = int(np.count_nonzero(results["batch"].status))
    ours, theirs = times["batch"] / count, times["rosen"] / count
    return compare(f"batch of {count}", ours, "NumPy's batched Rosen", theirs, 1 / 0.8, failed)


def compare(work: str, ours: np.ndarray, beside: str, theirs: np.ndarray, bar: float, failed: int) -> Row:
    """Of seconds by repetition."""
    one, other = 1e6 * float(np.median(ours)), 1e6 * float(np.median(theirs))
    return Row(work, one, beside, other, one / other, bar, failed)


def main() -> None:
    """Measures, prints and writes."""
    arguments = read_arguments(__doc__, repetitions=101, batch=10_000)
    compile_kernels()
    rows = [*measure_one(arguments.repetitions), measure_batch(max(arguments.repetitions // 5, 1), arguments.batch)]
    heads = "| work | µs | beside it | µs | ratio | bar | |"
    line = (
        "| {0.work} | {0.microseconds:.3g} | {0.beside} | {0.beside_microseconds:.3g} | {0.ratio:.2f} | "
        "≤ {0.bar:.2f} | {0.verdict} |"
    )
    failures = f"CPU time, medians, in turns; of a batch a problem's. Failures: {sum(row.failed for row in rows)}."
    publish(arguments, f"Problems of ({N}, {M})", [table(heads, line, rows), f"{failures} {machine()}."], rows)


if __name__ == "__main__":
    main()
