"""How much memory does a direction take at the size of a network, beside g and J, kind by kind?

What construction and solve add to the most memory that a new process held until then, as a share of g and J; the
direction itself is 1/(1 + m) of these. On rung "gramian", and on "pairs", where two rows nearly oppose each other.

Kinds: two arrays of NumPy's; a tree, a list of 100 leaves, rows apart; PyTorch's tensors, and a tree of these. Where
PyTorch is not installed its lines are missing, and said to be.

    OMP_NUM_THREADS=1 python benchmarks/long_memory.py [--parameters 10000000] [--constraints 1,5,31]
        [--kinds float64,float32,…] [--out benchmarks/results]

Limitations: one machine; the allocator's habits count, and code that is loaded before does not.
"""

import argparse
import importlib.util
import itertools
import json
import os
import platform
import subprocess
import sys
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from long_problems import ANGLE, direction, numbers
from tables import write

SLACK, LEAVES, BLOCK = 0.05, 100, 100_000
ARRAYS, TENSORS = ("float64", "float32", "tree"), ("tensor float32", "tensor bfloat16", "tensor tree")


@dataclass(frozen=True)
class Memory:
    """Most memory that construction and solve of one new process add, and its share of g and J."""

    kind: str
    n: int
    m: int
    rung: str
    megabytes: float
    share: float
    bar: float


def forget_peak() -> None:
    """The most memory that this process held ← what it holds now; Linux only, elsewhere what it held before counts."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def peak() -> float:
    """Most memory that this process held, in bytes, since it was last forgotten."""
    with suppress(OSError):
        status = Path("/proc/self/status").read_text(encoding="ascii")
        return 1024.0 * int(status.partition("VmHWM:")[2].split()[0])
    import resource  # not on Windows

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def leaves_of(kind: str, n: int, m: int, *, opposing: bool) -> list[Any]:
    """[g; J] of each leaf, (1 + m, k), standard normal, made in blocks so that nothing larger was ever held.

    opposing: the last row is the one before, turned around but for `ANGLE`.
    """
    rng, sizes = np.random.default_rng([n, m]), [n]
    if kind.endswith("tree"):
        sizes = [len(part) for part in np.array_split(np.empty(n, np.int8), LEAVES)]
    leaves = [empty(kind, 1 + m, size) for size in sizes]
    for leaf in leaves:
        for start in range(0, leaf.shape[1], BLOCK):
            width = min(BLOCK, leaf.shape[1] - start)
            block = rng.standard_normal((1 + m, width), dtype=np.float32).astype(np.float64)
            if opposing:
                block[-1] = ANGLE * block[-1] - block[-2]
            leaf[:, start : start + width] = sys.modules["torch"].from_numpy(block) if kind in TENSORS else block
    return leaves


def empty(kind: str, rows: int, count: int) -> Any:
    """Not yet filled."""
    if kind not in TENSORS:
        return np.empty((rows, count), np.float64 if kind == "float64" else np.float32)
    import torch  # type: ignore[import-not-found,unused-ignore]

    return torch.empty((rows, count), dtype=torch.bfloat16 if kind == "tensor bfloat16" else torch.float32)


def solved(leaves: list[Any], kind: str, m: int, *, opposing: bool) -> Any:
    """Rows apart in a tree, else two arrays."""
    bound = 0.0 if opposing else 0.1 * np.random.default_rng(m).standard_normal(m) * len(leaves[0][0]) ** 0.5
    if not kind.endswith("tree"):
        return direction(leaves[0][0], leaves[0][1:], bound)[1]
    g, *rows = ([leaf[i] for leaf in leaves] for i in range(1 + m))
    return direction(g, rows, bound)[1]


def memory_here(kind: str, n: int, m: int, rung: str) -> Memory:
    """Of this process, which should be new: a shorter problem loads all code before."""
    short, opposing = max(8 * (1 + m), 1_100_000 // ((1 + m) * max(10, 1 + m))), rung == "pairs"
    solved(leaves_of(kind, short, m, opposing=opposing), kind, m, opposing=opposing)
    leaves = leaves_of(kind, n, m, opposing=opposing)
    forget_peak()
    before = peak()
    found = solved(leaves, kind, m, opposing=opposing)
    added, held = peak() - before, sum(leaf.nbytes for leaf in leaves)
    return Memory(kind, n, m, found.rung, 1e-6 * added, added / held, 1 / (1 + m) + SLACK)


def memory(kind: str, n: int, m: int, rung: str) -> Memory:
    """Of a new process."""
    command = [sys.executable, str(Path(__file__).resolve()), "--memory-of", f"{kind},{n},{m},{rung}"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    said = subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout
    return Memory(**json.loads(said))


def page(rows: list[Memory]) -> str:
    """The table with what it was measured on."""
    lines = "\n".join(
        f"| {row.kind} | {row.n:.0e} | {row.m} | {row.rung} | {row.megabytes:.0f} | {row.share:.3f} | "
        f"≤ {row.bar:.3f} | {'kept' if row.share <= row.bar else 'missed'} |"
        for row in rows
    )
    return (
        "# Memory of a direction at the size of a network\n\n"
        f"| kind | n | m | rung | MB | share of g and J | bar | |\n|---|--:|--:|---|--:|--:|--:|---|\n{lines}\n\n"
        f"{platform.machine()} {platform.system()}, Python {platform.python_version()}, NumPy {np.__version__}. "
        f"Command: `OMP_NUM_THREADS=1 python benchmarks/long_memory.py --parameters {rows[0].n} "
        "--out benchmarks/results`; more at its head.\n"
    )


def main() -> None:
    """Measure, print, and write when asked to."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--parameters", type=int, default=10_000_000, help="n")
    parser.add_argument("--constraints", type=numbers, default=[1, 5, 31], help="m, by commas")
    parser.add_argument("--kinds", default=",".join((*ARRAYS, *TENSORS)), help="by commas")
    parser.add_argument("--memory-of", help=argparse.SUPPRESS)  # kind,n,m,rung in this process
    parser.add_argument("--out", type=Path, help="folder for long_memory.csv and .md")
    arguments = parser.parse_args()
    if arguments.memory_of:
        kind, n, m, rung = arguments.memory_of.split(",")
        print(json.dumps(asdict(memory_here(kind, int(n), int(m), rung))))
        return
    kinds = arguments.kinds.split(",")
    if importlib.util.find_spec("torch") is None and any(kind in TENSORS for kind in kinds):
        print("SKIP torch: not installed, its lines are missing")
        kinds = [kind for kind in kinds if kind not in TENSORS]
    work = itertools.product(kinds, ("gramian", "pairs"), arguments.constraints)
    rows = [memory(kind, arguments.parameters, m, rung) for kind, rung, m in work]
    print(said := page(rows))
    write("long_memory", said, rows, arguments.out)


if __name__ == "__main__":
    main()
