"""Do solvers agree with exact arithmetic on thousands of trust-region problems?

    max gᵀd   s.t.   Jd ≥ b, = on E,   dᵀMd ≤ radius²

Each family's problems are integers times powers of two, so that `exact.trust_region` decides them without
rounding: the verdict, d (of several the shortest; where infeasible of least violation, and of those the best climb),
κ, and what the answer's own certificate is worth, the residuals being formed in rationals too.

    python benchmarks/trust_regions.py [--count 500] [--solvers active-set] [--families …] [--seed 0] [--out FOLDER]

A direction agrees where ‖d − d*‖_M ≤ radius · `allowance`, which follows the problem's conditioning; `--count` problems
are drawn of each family. Of those that disagree, the smallest is printed as Python that makes it.
Limitations: n ≤ 9, m ≤ 5; numbers of at most 50 bits. Exit status 1 if a solver disagreed.
"""

import argparse
import sys
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tables import table, write
from trust_region_judge import EPS, ERRORS, allowance, complaint, distance
from trust_region_problems import FAMILIES

from cpgrl_opt import SOLVERS, DirectionProblem, Status
from cpgrl_opt.exact.trust_region import exact_trust_region
from cpgrl_opt.solvers import supports


def stated(problem: DirectionProblem) -> str:
    """Python that makes it."""
    metric = None if problem.metric is None else problem.metric.tolist()
    parts = (problem.gradient.tolist(), problem.jacobian.tolist(), problem.bound.tolist(), problem.equality.tolist())
    return f"DirectionProblem({', '.join(map(repr, (*parts, metric, problem.radius)))})"


@dataclass(frozen=True)
class Row:
    """One solver on one family, `taken` problems of which it supports; declined: where it claimed nothing.

    worst: ‖d − d*‖ over what is allowed; problem: the smallest that it disagrees on, complaint: what is wrong there.
    """

    solver: str
    family: str
    problems: int
    feasible: int
    taken: int
    agreed: int
    declined: int
    worst: float
    complaint: str
    problem: str


CLAIMS = (Status.OPTIMAL, Status.INFEASIBLE)
# Their answers are good to rounding, the others' to their tolerance; and they may not decline.
EXACT = ("active-set", "enumeration", "nnls")


def examine(name: str, family: str, count: int, seed: int) -> Row:
    """`count` problems of a family put to a solver."""
    solver, feasible, taken, declined, worst = SOLVERS[name], 0, 0, 0, 0.0
    wrong: list[tuple[DirectionProblem, str]] = []
    error = ERRORS * EPS if name in EXACT else float(solver.tolerance)
    for number in range(count):
        problem = problem_of(family, number, seed)
        exact = exact_trust_region(problem)
        feasible += exact.feasible
        if not supports(solver, problem):
            continue
        taken += 1
        answer = solver.solve(problem)
        told = complaint(problem, exact, answer, solver.tolerance, error)
        if told and answer.status not in CLAIMS and name not in EXACT:
            declined += 1
        elif told:
            wrong.append((problem, told))
        if answer.status == CLAIMS[not exact.feasible]:
            worst = max(worst, distance(problem, exact, answer.value) / allowance(problem, exact, error))
    example, told = min(wrong, key=lambda each: (each[0].jacobian.size, len(stated(each[0]))), default=(None, ""))
    shown = "" if example is None else stated(example)
    return Row(name, family, count, feasible, taken, taken - len(wrong) - declined, declined, worst, told, shown)


def problem_of(family: str, number: int, seed: int) -> DirectionProblem:
    """Problem `number` of a family, the same whatever was drawn before."""
    return FAMILIES[family](np.random.default_rng([seed, zlib.crc32(family.encode()), number]))


def main() -> None:
    """Examine every solver on every family, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=500, help="problems of each family")
    parser.add_argument("--solvers", default="active-set", help="names, separated by commas")
    parser.add_argument("--families", default=",".join(FAMILIES), help="names, separated by commas")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="a folder for trust_regions.csv and .md")
    arguments = parser.parse_args()
    rows = []
    for name in arguments.solvers.split(","):
        for family in arguments.families.split(","):
            rows.append(examine(name, family, arguments.count, arguments.seed))
            row = rows[-1]
            print(
                f"{name} {family}: {row.agreed} of {row.taken} agree, {row.declined} declined, worst {row.worst:.2g}"
                f" {row.complaint} {row.problem}",
                flush=True,
            )
    write("trust_regions", page(rows, arguments.count), rows, arguments.out)
    sys.exit(any(row.complaint for row in rows))


def page(rows: list[Row], count: int) -> str:
    """The table, and how many disagree."""
    heads = "| solver | family | feasible | agree | declined | worst | smallest disagreement |"
    line = (
        "| {0.solver} | {0.family} | {0.feasible:d} | {0.agreed:d} of {0.taken} | {0.declined:d} | {0.worst:.2g} | "
        "{0.complaint} |"
    )
    disagreed = sum(row.taken - row.agreed - row.declined for row in rows)
    return (
        f"# Trust regions against exact arithmetic\n\n`python benchmarks/trust_regions.py --count {count}`: "
        f"{sum(row.taken for row in rows)} problems solved, {disagreed} disagree. Worst: ‖d − d*‖ in units of what the "
        f"problem's conditioning allows.\n\n{table(heads, line, rows)}\n"
    )


if __name__ == "__main__":
    main()
