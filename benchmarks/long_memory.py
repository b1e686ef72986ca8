"""How much memory does a direction take at the size of a network, beside g and J, kind by kind?

What construction and solve add to the most memory that a new process held until then, as a share of g and J; the
direction itself is 1/(1 + m) of these. On rung "gramian", and on "pairs", where two rows nearly oppose each other.

Kinds: two arrays of NumPy's; a tree, a list of 100 leaves, rows apart; PyTorch's tensors, and a tree of these. Where
PyTorch is not installed its lines are missing, and said to be.

    OMP_NUM_THREADS=1 python benchmarks/long_memory.py [--parameters 10000000] [--constraints 1,5,31]
        [--kinds float64,float32,…] [--out benchmarks/results]

Limitations: one machine; the allocator's habits count, and code that is loaded before does not.
"""

import importlib.util
import itertools
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from long_problems import ANGLE, direction
from tables import machine, publish, read_arguments, table, verdict

SLACK, LEAVES, BLOCK, RUNGS = 0.05, 100, 100_000, ("gramian", "pairs")
ARRAYS, TENSORS = ("float64", "float32", "tree"), ("tensor float32", "tensor bfloat16", "tensor tree")


@dataclass(frozen=True)
class Row:
    """Most memory that construction and solve of one new process add, and its share of g and J."""

    kind: str
    n: int
    m: int
    rung: str
    megabytes: float
    share: float
    bar: float

    @property
    def verdict(self) -> str:
        """Of the bar."""
        return verdict(self.share, self.bar)


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


def solve(leaves: list[Any], kind: str, m: int, *, opposing: bool) -> Any:
    """Rows apart in a tree, else two arrays."""
    bound = 0.0 if opposing else 0.1 * np.random.default_rng(m).standard_normal(m) * len(leaves[0][0]) ** 0.5
    if not kind.endswith("tree"):
        return direction(leaves[0][0], leaves[0][1:], bound)[1]
    g, *rows = ([leaf[i] for leaf in leaves] for i in range(1 + m))
    return direction(g, rows, bound)[1]


def measure_here(kind: str, n: int, m: int, rung: str) -> Row:
    """Of this process, which should be new: a shorter problem loads all code before."""
    short, opposing = max(8 * (1 + m), 1_100_000 // ((1 + m) * max(10, 1 + m))), rung == "pairs"
    solve(leaves_of(kind, short, m, opposing=opposing), kind, m, opposing=opposing)
    leaves = leaves_of(kind, n, m, opposing=opposing)
    forget_peak()
    before = peak()
    found = solve(leaves, kind, m, opposing=opposing)
    added, held = peak() - before, sum(leaf.nbytes for leaf in leaves)
    return Row(kind, n, m, found.rung, 1e-6 * added, added / held, 1 / (1 + m) + SLACK)


def main() -> None:
    """Measures, each in a new process, prints and writes."""
    kinds = [*ARRAYS, *TENSORS]
    arguments = read_arguments(__doc__, parameters=10_000_000, constraints=[1, 5, 31], kinds=kinds)
    kinds = arguments.kinds
    if importlib.util.find_spec("torch") is None and any(kind in TENSORS for kind in kinds):
        print("SKIP torch: not installed, its lines are missing")
        kinds = [kind for kind in kinds if kind not in TENSORS]
    lines = itertools.product(kinds, RUNGS, arguments.constraints)
    work = [(kind, arguments.parameters, m, rung) for kind, rung, m in lines]
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), max_tasks_per_child=1) as new_process:
        rows = list(new_process.map(measure_here, *zip(*work, strict=True)))
    heads = "| kind | n | m | rung | MB | share of g and J | bar | |"
    bars = "{0.share:.3f} | ≤ {0.bar:.3f} | {0.verdict}"
    line = f"| {{0.kind}} | {{0.n:.0e}} | {{0.m:d}} | {{0.rung}} | {{0.megabytes:.0f}} | {bars} |"
    title = "Memory of a direction at the size of a network"
    publish(arguments, title, [table(heads, line, rows), f"{machine()}."], rows)


if __name__ == "__main__":
    main()
