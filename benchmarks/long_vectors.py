"""How long does a direction take at the size of a network? (How much memory: `long_memory.py`.)

    floor: A @ A.T, w @ A, J @ d      A = [g; J], (1 + m, n); the three products that a direction needs, by BLAS

Everything is measured in turns with this floor, in one process, and given as a ratio to it:

- direction: a `DirectionProblem` made of arrays, solved by `active-set` and certified;
- (n, m) storage, rows apart: the same, where J lies column by column, or is a list of m arrays;
- equality, restoring: a `ConstrainedStep` on a `Linearization`, all constraints violated;
- residuals: `kkt_residuals` of a direction;
- near opposing: a direction where the last row is 1e-5 rad from opposing the one before (g, where m = 1).

Accuracy beside time: the worst KKT residual; of a step how far J Δθ is from −αₑ slack, in units of ‖Jᵢ‖‖Δθ‖.

    slope in n    log(t₂/t₁) / log(n₂/n₁) of a direction, from the least n to the largest; 1: time grows as n does
    slope in m    log(t₂/t₁) / log(m₂/m₁), from the least m to the largest at n = 10⁶; 2: as the Gramian does

    OMP_NUM_THREADS=1 python benchmarks/long_vectors.py [--parameters 100000,1000000,10000000]
        [--constraints 1,5,31,50] [--out benchmarks/results]

Limitations: one machine, whatever else it does at the time; CPU seconds, medians. Gradients are standard normal
numbers, so rows are nearly orthogonal; half of the bounds of a direction hold with equality. What has more numbers than
--most is left out (1e8: 0.8 GB, held two or three times); --scale: times the usual number of repeats.
"""

import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from long_problems import Answer, Data, direction, draw, judge, oppose, repeats_of, time_beside
from tables import machine, publish, read_arguments, table, verdict

from cpgrl_opt import ConstrainedStep, Linearization, kkt_residuals

DIRECTION, FORMS = "direction", ("(n, m) storage", "rows apart")
STEPS, RESIDUALS, OPPOSING = ("equality", "restoring"), "residuals", "near opposing"
WORKS = (DIRECTION, *FORMS, *STEPS, RESIDUALS, OPPOSING)
BARS = {DIRECTION: 0.8, **dict.fromkeys((*FORMS, *STEPS), 1.0)}  # of the floor, at n = 10⁶ and m = 5
REFERENCE = 1_000_000


@dataclass(frozen=True)
class Row:
    """One work at one size; milliseconds are medians, the floor's of the same turns."""

    work: str
    n: int
    m: int
    milliseconds: float
    floor_milliseconds: float
    ratio: float
    rung: str  # "" of a step and of residuals, which do not say
    error: float
    failed: int
    repeats: int


def judge_step(data: Data, step: ConstrainedStep, result: Any) -> Answer:
    """Δθ should restore: J Δθ = −αₑ slack, or exceed it in `restoring`."""
    lack = -float(step.restoration_rate) * data.values[1:] - data.J @ result.change
    lack = np.abs(lack) if step.formulation == "equality" else np.maximum(lack, 0.0)
    size = np.sqrt(np.vecdot(data.J, data.J)) * np.linalg.norm(result.change)
    return Answer("", float((lack / size).max()), bool(result.counts["skipped"] + result.counts["fallback"]))


def works(data: Data) -> Iterator[tuple[str, Callable[[], Any], Callable[[Any], Answer]]]:
    """(name, what is timed, how its result is judged), one after the other, so that copies of J do not add up."""
    thresholds = np.zeros(len(data.J))

    def judge_pair(pair: tuple[Any, Any]) -> Answer:
        return judge(*pair)

    yield DIRECTION, partial(direction, data.g, data.J, data.bound), judge_pair
    problem, found = direction(data.g, data.J, data.bound)
    yield RESIDUALS, lambda: kkt_residuals(problem, found), lambda residuals: Answer("", residuals.worst, False)
    for formulation in STEPS:
        step = ConstrainedStep(formulation=formulation)
        yield formulation, partial(move, step, data, thresholds), partial(judge_step, data, step)
    yield FORMS[0], partial(direction, data.g, np.asfortranarray(data.J), data.bound), judge_pair
    yield FORMS[1], partial(direction, data.g, [row.copy() for row in data.J], data.bound), judge_pair
    oppose(data.gradients)
    yield OPPOSING, partial(direction, data.g, data.J, thresholds), judge_pair


def move(step: ConstrainedStep, data: Data, thresholds: np.ndarray) -> Any:
    """The step's change and what is told of it."""
    return step(Linearization(data.values, data.gradients), thresholds)


def measure(n: int, m: int, scale: float) -> list[Row]:
    """Every work at one size, each in turns with the floor."""
    data, rng = draw(n, m), np.random.default_rng(0)
    w, d, repeats = rng.standard_normal(1 + m), rng.standard_normal(n), repeats_of(n, m, scale)

    def floor() -> None:
        _ = data.gradients @ data.gradients.T, w @ data.gradients, data.J @ d

    rows = []
    for work, run, judge_result in works(data):
        beside, ours, _, result = time_beside(floor, run, repeats)
        answer, times = judge_result(result), (1e3 * ours, 1e3 * beside)
        rows.append(Row(work, n, m, *times, ours / beside, answer.rung, answer.error, answer.failed, repeats))
    return rows


def slope(first: tuple[float, float], last: tuple[float, float]) -> float:
    """log(t₂/t₁) / log(x₂/x₁) of two (x, t)."""
    return math.log(last[1] / first[1]) / math.log(last[0] / first[0]) if last[0] > first[0] else math.nan


def verdicts(rows: Sequence[Row]) -> Iterator[tuple[str, str, float, str]]:
    """(what, bar, measured, whether it is kept)."""
    for row in rows:
        if row.n == REFERENCE and row.m == 5 and row.work in BARS:
            bar = BARS[row.work]
            yield f"{row.work}, n = {row.n:.0e}, m = 5", f"≤ {bar:g}", row.ratio, verdict(row.ratio, bar)
    plain = [row for row in rows if row.work == DIRECTION]
    for m in sorted({row.m for row in plain}):
        points = sorted((float(row.n), row.milliseconds) for row in plain if row.m == m)
        if not math.isnan(rate := slope(points[0], points[-1])):
            ends = f"{points[0][0]:.0e} to {points[-1][0]:.0e}"
            yield f"slope in n, {ends}, m = {m}", "1 ± 0.1", rate, verdict(abs(rate - 1), 0.1)
    points = sorted((float(row.m), row.milliseconds) for row in plain if row.n == REFERENCE)
    if points and not math.isnan(rate := slope(points[0], points[-1])):
        ends = f"{points[0][0]:g} to {points[-1][0]:g}"
        yield f"slope in m, {ends}, n = {REFERENCE:.0e}", "≤ 2", rate, verdict(rate, 2)


def ratios(rows: Sequence[Row]) -> str:
    """A line for each size, ratios to the floor by work."""
    lines = []
    for n, m in dict.fromkeys((row.n, row.m) for row in rows):
        by_work = {row.work: row for row in rows if (row.n, row.m) == (n, m)}
        one, rungs = by_work[DIRECTION], f"{by_work[DIRECTION].rung}; {by_work[OPPOSING].rung}"
        error = max(row.error for row in by_work.values())
        times = one.floor_milliseconds, one.milliseconds, *(by_work[work].ratio for work in WORKS)
        lines.append((n, m, *times, rungs, error))
    each = " | ".join(f"{{0[{4 + k}]:.2f}}" for k in range(len(WORKS)))
    line = f"| {{0[0]:.0e}} | {{0[1]:d}} | {{0[2]:.3g}} | {{0[3]:.3g}} | {each} | {{0[11]}} | {{0[12]:.0e}} |"
    heads = f"| n | m | floor, ms | {DIRECTION}, ms | {' | '.join(WORKS)} | rungs | worst error |"
    return table(heads, line, lines)


def main() -> None:
    """Measures, prints and writes."""
    sizes = {"parameters": [100_000, 1_000_000, 10_000_000], "constraints": [1, 5, 31, 50]}
    arguments = read_arguments(__doc__, **sizes, most=1e8, scale=1.0)
    if (threads := os.environ.get("OMP_NUM_THREADS")) != "1":
        print("OMP_NUM_THREADS should be 1 before Python starts: BLAS may use several threads", file=sys.stderr)
    sizes = [(n, m) for n in arguments.parameters for m in arguments.constraints if n * (1 + m) <= arguments.most]
    rows = [row for n, m in sizes for row in measure(n, m, arguments.scale)]
    about = (
        f"CPU time over that of `A @ A.T`, `w @ A` and `J @ d`, in turns with these; medians; OMP_NUM_THREADS is "
        f"{threads}. Rungs: of the direction; of rows near opposing. "
        f"Failures: {sum(row.failed for row in rows)} of {len(rows)}."
    )
    bars = table("| | bar | measured | |", "| {0[0]} | {0[1]} | {0[2]:.3g} | {0[3]} |", verdicts(rows))
    publish(arguments, "Directions at the size of a network", [about, ratios(rows), bars, f"{machine()}."], rows)


if __name__ == "__main__":
    main()
