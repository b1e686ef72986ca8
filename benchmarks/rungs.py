"""Which rung answers long problems of each kind, and does it say what the rows themselves say?

Every problem of every family of the comparison, as if it were a long one: g and the rows get zeros between their
numbers, which changes no inner product, and go up the ladder of `solvers/span.py`. Beside it `active-set` on the rows
as they are. Apart: ‖d − d′‖/max(‖g‖, ‖d‖) where both are OPTIMAL.

    python benchmarks/rungs.py [--problems 40] [--seed 0] [--out benchmarks/results]

Limitations: families of few parameters, most of which do not determine a direction to more digits than float64 has.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from tables import publish, read_arguments, table

from cpgrl_opt import SOLVERS, DirectionProblem, Status
from cpgrl_opt.comparison.families import FAMILIES, ProblemFamily
from cpgrl_opt.solvers.span import solve_in_span

RUNGS = ("gramian", "pairs", "rows")
LARGE = 4  # of a family of more than a hundred parameters this many problems at the most


@dataclass(frozen=True)
class Row:
    """One family: how many problems each rung answered, how many have another status, and how far apart they are."""

    family: str
    problems: int
    gramian: int
    pairs: int
    rows: int
    other_status: int
    apart: float


def spread(problem: DirectionProblem) -> DirectionProblem:
    """The same inner products, in five times as many parameters and one more for each vector."""
    n = 5 * problem.n + 5 * (1 + problem.m)
    g, J = np.zeros(n), np.zeros((problem.m, n))
    g[: 5 * problem.n : 5], J[:, : 5 * problem.n : 5] = problem.gradient, problem.jacobian
    return DirectionProblem.trusted(g, J, problem.bound, problem.equality)


def measure(family: ProblemFamily, count: int, seed: int) -> Row:
    """The family's first problems."""
    solver = SOLVERS["active-set"]
    count = min(count, LARGE) if family.is_large else count
    rungs, other, apart = Counter[str](), 0, 0.0
    for number in range(count):
        problem = spread(family.problem(number, seed))
        on_rows = solver.solve_rows(problem)  # type: ignore[attr-defined]
        found = solve_in_span(solver.solve_rows, problem, solver.tolerance, is_exact=True)  # type: ignore[attr-defined]
        rungs[found.rung] += 1
        other += found.status != on_rows.status
        if found.status == on_rows.status == Status.OPTIMAL:
            size = max(float(np.linalg.norm(problem.gradient)), float(np.linalg.norm(on_rows.value))) or 1.0
            apart = max(apart, float(np.linalg.norm(found.value - on_rows.value)) / size)
    return Row(family.name, count, *(rungs[rung] for rung in RUNGS), other, apart)


def euclidean() -> list[str]:
    """The families without metric and ball: with one, the rows that the ladder sees are others."""
    drawn = {name: family.problem(0, 0) for name, family in FAMILIES.items()}
    return [name for name, problem in drawn.items() if problem.metric is None and problem.radius is None]


def main() -> None:
    """Measures, prints and writes."""
    arguments = read_arguments(__doc__, problems=40, seed=0, families=euclidean())
    rows = [measure(FAMILIES[name], arguments.problems, arguments.seed) for name in arguments.families]
    heads = "| family | problems | gramian | pairs | rows | other status | apart |"
    counts = "{0.problems:d} | {0.gramian:d} | {0.pairs:d} | {0.rows:d} | {0.other_status:d}"
    lines = table(heads, f"| {{0.family}} | {counts} | {{0.apart:.0e}} |", rows)
    publish(arguments, "Which rung answers which family", ["Rungs: `docs/architecture.md`.", lines], rows)


if __name__ == "__main__":
    main()
