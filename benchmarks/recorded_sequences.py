"""What is a warm start worth on the problems that training really poses, one after the other?

The recordings that ship with the package, in the order met: as they were (equalities), and with inequalities in their
place (what the formulation "cone" asks at the same θ). A solver with an explicit warm start (`session(n, m,
warm_start=True)`) is replayed cold and warm in one workspace for each sequence; the others cold, beside it.

    python benchmarks/recorded_sequences.py [--repeats 5] [--out benchmarks/results]

Limitations: one machine; CPU seconds of `solve`, our shared preparation and certificate included, the least of the
repetitions of each problem, medians over problems. Iterations as each method counts them, 0 where it does not tell.
cvxpy's session takes warm_start but its CLARABEL has none.
"""

import argparse
import csv
import platform
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from cpgrl_opt import SOLVERS
from cpgrl_opt.comparison.recording import SHIPPED, Recording, shipped_recording
from cpgrl_opt.comparison.replay import replay
from cpgrl_opt.solvers import is_installed, supports

COLD = ("active-set", "rosen", "nnls", "daqp", "piqp", "osqp")
WARM = ("osqp",)


@dataclass(frozen=True)
class Row:
    """One solver on one recording."""

    recording: str
    problems: int
    solver: str
    start: str
    certified: int
    median_iterations: float
    mean_iterations: float
    median_microseconds: float


def measured(name: str, recording: Recording, repeats: int) -> Iterator[Row]:
    """A row for each solver, cold, and warm where it has such a start."""
    for solver_name, warm in [*((solver, False) for solver in COLD), *((solver, True) for solver in WARM)]:
        solver = SOLVERS[solver_name]
        if not is_installed(solver) or not supports(solver, recording.problems[0]):
            continue
        replay(recording, solver, warm=warm)  # compiles
        done = replay(recording, solver, warm=warm, repeats=repeats)
        yield Row(
            name, len(recording), solver_name, "warm" if warm else "cold", int((done.status == 0).sum()),
            float(np.median(done.iterations)), round(float(done.iterations.mean()), 1),
            round(1e6 * float(np.median(done.seconds)), 1),
        )  # fmt: skip


def main() -> None:
    """Measures, prints and writes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("results"))
    arguments = parser.parse_args()
    rows = []
    for name in SHIPPED:
        recording = shipped_recording(name)
        for kind, own in (("as met", recording), ("cone", recording.as_inequalities())):
            rows += list(measured(f"{name}, {kind}", own, arguments.repeats))
    header = list(asdict(rows[0]))
    with (arguments.out / "recorded_sequences.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, header, lineterminator="\n")
        writer.writeheader()
        writer.writerows(map(asdict, rows))
    lines = ["# Recorded sequences, cold and warm", "", "`python benchmarks/recorded_sequences.py`", ""]
    lines += [f"| {' | '.join(map(str, cells))} |" for cells in (header, ["---"] * len(header))]
    lines += [f"| {' | '.join(str(value) for value in asdict(row).values())} |" for row in rows]
    lines += ["", f"{platform.platform()}, Python {platform.python_version()}, {arguments.repeats} repetitions."]
    (arguments.out / "recorded_sequences.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
