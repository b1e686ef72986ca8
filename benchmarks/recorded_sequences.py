"""What is a warm start worth on the problems that training really poses, one after the other?

The recordings that ship with the package, in the order met: as they were (equalities), and with inequalities in their
place (what the formulation "cone" asks at the same θ); or, with `--recording`, what your own training posed, as
`subproblems.npz` of `--record N` holds it: then nothing but `--out` is written to. A solver with an explicit warm start
(`session(n, m, warm_start=True)`) is replayed cold and warm in one workspace for each sequence; the others cold, beside
it. Certified: optimal, or infeasible with a proof.

    python benchmarks/recorded_sequences.py [--repeats 5] [--out benchmarks/results]
    python benchmarks/recorded_sequences.py --recording FILE [--recording FILE …] [--out FOLDER]

Limitations: one machine; CPU seconds of `solve`, our shared preparation and certificate included, the least of the
repetitions of each problem, medians over problems. Iterations as each method counts them, 0 where it does not tell.
"""

import argparse
import platform
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from tables import table, write

from cpgrl_opt import SOLVERS, Status
from cpgrl_opt.comparison.recording import SHIPPED, Recording, load_recording, shipped_recording
from cpgrl_opt.comparison.replay import replay
from cpgrl_opt.solvers import is_usable, supports

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
    """A row for each solver that takes all problems, cold, and warm where it has such a start."""
    for solver_name, warm in [*((solver, False) for solver in COLD), *((solver, True) for solver in WARM)]:
        solver = SOLVERS[solver_name]
        if not is_usable(solver) or not all(supports(solver, problem) for problem in recording.problems):
            continue
        replay(recording, solver, warm=warm)  # compiles
        done = replay(recording, solver, warm=warm, repeats=repeats)
        yield Row(
            name, len(recording), solver_name, "warm" if warm else "cold",
            int((done.status <= Status.INFEASIBLE).sum()), float(np.median(done.iterations)),
            round(float(done.iterations.mean()), 1), round(1e6 * float(np.median(done.seconds)), 1),
        )  # fmt: skip


def recordings(paths: Sequence[Path]) -> Iterator[tuple[str, Recording]]:
    """(name, recording) of these files, of the shipped ones without any; with inequalities too, where that differs.

    ValueError for a file that is no recording, or one of no problem.
    """
    given = [(str(path), load_recording(path)) for path in paths]
    for name, recording in given or [(name, shipped_recording(name)) for name in SHIPPED]:
        if not len(recording):
            raise ValueError(f"{name} should hold at least one problem; found none")
        yield f"{name}, as met", recording
        if recording.equality.any():
            yield f"{name}, cone", recording.as_inequalities()


def main() -> None:
    """Measures, prints and writes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--recording", type=Path, action="append", default=[])
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    try:
        chosen = list(recordings(arguments.recording))
    except ValueError as error:
        parser.error(str(error))
    rows = [row for name, recording in chosen for row in measured(name, recording, arguments.repeats)]
    command = " ".join(["python benchmarks/recorded_sequences.py", *(f"--recording {p}" for p in arguments.recording)])
    names = [each.name for each in fields(Row)]
    heads, line = f"| {' | '.join(names)} |", f"| {' | '.join(f'{{0.{name}}}' for name in names)} |"
    page = (
        f"# Recorded sequences, cold and warm\n\n`{command}`\n\n{table(heads, line, rows)}\n\n"
        f"{platform.platform()}, Python {platform.python_version()}, {arguments.repeats} repetitions.\n"
    )
    print(page)
    out = arguments.out or (None if arguments.recording else Path(__file__).with_name("results"))
    write("recorded_sequences", page, rows, out)


if __name__ == "__main__":
    main()
