"""How much memory does a direction take at the size of a network, beside g and J?

What construction and solve add to the most memory that a new process ever held (ru_maxrss), as a share of g and J; the
direction itself is 1/(1 + m) of these. On rung "gramian", and on "pairs", where two rows nearly oppose each other.

    OMP_NUM_THREADS=1 python benchmarks/long_memory.py [--parameters 10000000] [--constraints 1,5,31]
        [--out benchmarks/results]

Limitations: one machine; the allocator's habits count, and code that is loaded before does not.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from long_problems import direction, drawn, numbers, oppose, write

SLACK = 0.05


@dataclass(frozen=True)
class Memory:
    """Most memory that construction and solve of one new process add, and its share of g and J."""

    n: int
    m: int
    rung: str
    megabytes: float
    share: float
    bar: float


def peak() -> float:
    """Most memory that this process held so far, in bytes."""
    import resource  # not on Windows

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def memory_here(n: int, m: int, rung: str) -> Memory:
    """Of this process, which should be new: a short problem loads all code before."""
    short = drawn(max(8 * (1 + m), 1_100_000 // ((1 + m) * max(10, 1 + m))), m)
    data = drawn(n, m)
    for each in (short, data):
        if rung == "pairs":
            oppose(each.gradients)
            each.bound[:] = 0.0
    direction(short.g, short.J, short.bound)
    before = peak()
    _, found = direction(data.g, data.J, data.bound)
    added = peak() - before
    return Memory(n, m, found.rung, 1e-6 * added, added / data.gradients.nbytes, 1 / (1 + m) + SLACK)


def memory(n: int, m: int, rung: str) -> Memory:
    """Of a new process."""
    command = [sys.executable, str(Path(__file__).resolve()), "--memory-of", f"{n},{m},{rung}"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    said = subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout
    return Memory(**json.loads(said))


def page(rows: list[Memory]) -> str:
    """The table with what it was measured on."""
    lines = "\n".join(
        f"| {row.n:.0e} | {row.m} | {row.rung} | {row.megabytes:.0f} | {row.share:.3f} | ≤ {row.bar:.3f} | "
        f"{'kept' if row.share <= row.bar else 'missed'} |"
        for row in rows
    )
    return (
        "# Memory of a direction at the size of a network\n\n"
        f"| n | m | rung | MB | share of g and J | bar | |\n|--:|--:|---|--:|--:|--:|---|\n{lines}\n\n"
        f"{platform.machine()} {platform.system()}, Python {platform.python_version()}, NumPy {np.__version__}. "
        "Command: `OMP_NUM_THREADS=1 python benchmarks/long_memory.py --out benchmarks/results`; more at its head.\n"
    )


def main() -> None:
    """Measure, print, and write when asked to."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--parameters", type=int, default=10_000_000, help="n")
    parser.add_argument("--constraints", type=numbers, default=[1, 5, 31], help="m, by commas")
    parser.add_argument("--memory-of", help=argparse.SUPPRESS)  # n,m,rung in this process
    parser.add_argument("--out", type=Path, help="folder for long_memory.csv and .md")
    arguments = parser.parse_args()
    if arguments.memory_of:
        n, m, rung = arguments.memory_of.split(",")
        print(json.dumps(asdict(memory_here(int(n), int(m), rung))))
        return
    rows = [memory(arguments.parameters, m, rung) for rung in ("gramian", "pairs") for m in arguments.constraints]
    print(said := page(rows))
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        (arguments.out / "long_memory.md").write_text(said, encoding="utf-8")
        write(arguments.out / "long_memory.csv", Memory, rows)


if __name__ == "__main__":
    main()
