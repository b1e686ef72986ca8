"""Against TorchJD, kind by kind: how long does a direction of tensors take, and what does another kind of vectors cost?

Six rows, of which two conflict with the first and with the mean, by `active-set`: a `DirectionProblem` is made of the
tensors as they lie, solved, certified, and handed back as a tensor.

- first: g is the first row, J the five others, b = 0; TorchJD's `DualProj(pref_vector=e₁)` projects the same row onto
  the same cone: that of all six, but d·g ≥ d·d ≥ 0 holds wherever the others do. The bars are for this one;
- mean: g is the mean of all six rows, and J all six, as for `DualProj()` and `UPGrad()`: seven vectors, of which
  TorchJD forms six, and the mean is part of our time.

TorchJD takes no bfloat16: there the way to float32 and back is part of its time. Then each kind of vectors is timed at
one n in turns with two NumPy arrays g and J of its dtype (of bfloat16: of float32).

Accuracy beside time: the worst KKT residual of what was handed back, which is rounded to its dtype.

    OMP_NUM_THREADS=1 python benchmarks/tensors.py [--parameters 1000,100000,1000000] [--reference 1000000]
        [--out benchmarks/results]

Limitations: one machine, whatever else it does at the time; CPU seconds, medians, one thread. TorchJD adds 1e-4 to the
normalised Gramian and certifies nothing: its answer is another one, `apart` from ours by that much of ‖g‖; UPGrad's is
of another problem. Without PyTorch, TorchJD or JAX their lines are missing, and said to be.
"""

import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
from long_problems import direction, judge, repeats_of, time_beside
from tables import machine, publish, read_arguments, table, verdict

ROWS, LEAVES = 6, 100
BARS = {1_000: 1.0, 100_000: 0.8, 1_000_000: 0.6}  # of DualProj's time; of UPGrad's 1, and of arrays' 1.3 for trees
TREE = f"tree of {LEAVES}"


@dataclass(frozen=True)
class Row:
    """One kind of vectors beside something else; milliseconds are medians of the same turns."""

    kind: str
    n: int
    g: str
    beside: str
    milliseconds: float
    beside_milliseconds: float
    ratio: float
    bar: float  # NaN where there is none
    rung: str
    error: float
    apart: float  # from the other answer, over ‖g‖; NaN where that is ours too
    failed: int

    @property
    def verdict(self) -> str:
        """Of the bar."""
        return verdict(self.ratio, self.bar)


def draw(n: int) -> np.ndarray:
    """(6, n), float32, standard normal; the first row is three times as long, and two others lean away from it."""
    A = np.random.default_rng(n).standard_normal((ROWS, n), dtype=np.float32)
    A[1:3] -= np.float32(0.6) * A[0]
    A[0] *= np.float32(3.0)
    return A


def available(names: Sequence[str]) -> dict[str, Any]:
    """Packages that can be imported; the others are said to be missing."""
    found = {}
    for name in names:
        try:
            found[name] = import_module(name)
        except ImportError:
            print(f"SKIP {name}: not installed, its lines are missing")
    return found


def compare(kind: str, n: int, g: str, beside: str, bar: float, scale: float, *runs: Callable[[], Any]) -> Row:
    """The first run, which gives (problem, direction), in turns with the other."""
    repeats = repeats_of(n, ROWS, scale) * (10 if n < 10_000 else 1)
    theirs, ours, given, (problem, found) = time_beside(runs[1], runs[0], repeats)
    answer, apart = judge(problem, found), math.nan
    if not isinstance(given, tuple):
        difference = problem.row_of(found.value) - given.double().numpy()
        apart = float(np.linalg.norm(difference) / np.linalg.norm(problem.gradient))
    times = 1e3 * ours, 1e3 * theirs, ours / theirs
    return Row(kind, n, g, beside, *times, bar, answer.rung, answer.error, apart, answer.failed)


def climb_first(A: Any) -> Any:
    """(problem, direction) of the first row among the others."""
    return direction(A[0], A[1:], 0.0)


def climb_mean(A: Any) -> Any:
    """The same of their mean."""
    return direction(A.mean(0), A, 0.0)


def aggregate(aggregator: Any, A: Any, wide: Any) -> Any:
    """TorchJD's d in the dtype of A."""
    return aggregator(A.to(wide)).to(A.dtype)


def beside_torchjd(sizes: Sequence[int], scale: float) -> Iterator[Row]:
    """Tensors of each dtype."""
    found = available(["torch", "torchjd.aggregation"])
    if len(found) < 2:
        return
    torch, jd = found["torch"], found["torchjd.aggregation"]
    torch.set_num_threads(1)
    for n in sizes:
        for dtype in (torch.float32, torch.float64, torch.bfloat16):
            A, wide = torch.from_numpy(draw(n)).to(dtype), torch.promote_types(dtype, torch.float32)
            kind, first = f"tensor, {str(dtype).removeprefix('torch.')}", torch.eye(ROWS, dtype=wide)[0]
            for g, name, aggregator, bar in (
                ("first", "DualProj", jd.DualProj(pref_vector=first), BARS.get(n, math.nan)),
                ("mean", "DualProj", jd.DualProj(), math.nan),
                ("mean", "UPGrad", jd.UPGrad(), 1.0),
            ):
                run = partial(climb_first if g == "first" else climb_mean, A)
                yield compare(kind, n, g, name, bar, scale, run, partial(aggregate, aggregator, A, wide))


def each_row(parts: list[Any]) -> tuple[list[Any], list[list[Any]]]:
    """g and the rows of J, each a list of leaves."""
    g, *rows = ([part[i] for part in parts] for i in range(ROWS))
    return g, rows


def kinds(A: np.ndarray) -> Iterator[tuple[str, np.ndarray, Any, Any]]:
    """(name, array of which the time is the unit, g, J)."""
    packages, wide = available(["torch", "jax"]), A.astype(np.float64)
    for B in (wide, A):
        parts = [part.copy() for part in np.array_split(B, LEAVES, axis=1)]
        yield f"rows apart, {B.dtype}", B, B[0], [row.copy() for row in B[1:]]
        yield f"{TREE}, stacked, {B.dtype}", B, [part[0] for part in parts], [part[1:] for part in parts]
        yield f"{TREE}, rows apart, {B.dtype}", B, *each_row(parts)
    if "torch" in packages:
        torch = packages["torch"]
        torch.set_num_threads(1)
        tensor = torch.from_numpy(A)
        for B, given in ((wide, tensor.double()), (A, tensor), (A, tensor.bfloat16())):
            yield f"tensor, {str(given.dtype).removeprefix('torch.')}", B, given[0], given[1:]
        for B in (wide, A):
            parts = [part.clone() for part in torch.from_numpy(B).tensor_split(LEAVES, dim=1)]
            yield f"{TREE} tensors, stacked, {B.dtype}", B, [part[0] for part in parts], [part[1:] for part in parts]
            yield f"{TREE} tensors, rows apart, {B.dtype}", B, *each_row(parts)
    if "jax" in packages:
        array = packages["jax"].numpy.asarray(A)
        yield "JAX, float32", A, array[0], array[1:]


def beside_arrays(n: int, scale: float) -> Iterator[Row]:
    """Each kind, in turns with two arrays of NumPy's."""
    for kind, B, g, J in kinds(draw(n)):
        bar = 1.3 if kind.startswith(TREE) and n == max(BARS) else math.nan
        runs = partial(direction, g, J, 0.0), partial(direction, B[0], B[1:], 0.0)
        yield compare(kind, n, "first", "arrays", bar, scale, *runs)


def main() -> None:
    """Measures, prints and writes."""
    arguments = read_arguments(__doc__, parameters=list(BARS), reference=max(BARS), scale=1.0)
    rows = [
        *beside_torchjd(arguments.parameters, arguments.scale),
        *beside_arrays(arguments.reference, arguments.scale),
    ]
    heads = "| kind | n | g | beside | ms | its ms | ratio | bar | | rung | worst error | apart |"
    line = (
        "| {0.kind} | {0.n:.0e} | {0.g} | {0.beside} | {0.milliseconds:.3g} | {0.beside_milliseconds:.3g} | "
        "{0.ratio:.2f} | {0.bar:g} | {0.verdict} | {0.rung} | {0.error:.0e} | {0.apart:.0e} |"
    )
    about = (
        "CPU time of a direction of six rows, from construction to the certified answer in its own form, in turns with "
        f"what stands beside it; medians; OMP_NUM_THREADS is {os.environ.get('OMP_NUM_THREADS')}. Bars are the most "
        f"that a ratio may be. Failures: {sum(row.failed for row in rows)} of {len(rows)}."
    )
    lines = table(heads, line, rows).replace("| nan |", "| – |")
    used = [name for name in ("torch", "torchjd", "jax") if sys.modules.get(name)]
    publish(arguments, "Tensors, against TorchJD and kind by kind", [about, lines, f"{machine(*used)}."], rows)


if __name__ == "__main__":
    main()
