"""How long does a direction take under `jit` and `vmap`, beside what it cannot do without and beside a textbook's?

- 64 problems in one call, n = 9, m = 3 and n = 20, m = 5, by `vmap`: beside the Gramians V Vᵀ of the same call, and a
  textbook's projection on all rows, g + Jᵀ max(0, (J Jᵀ)⁻¹(b − J g)), which is right where all or none are active;
- one problem of n parameters and five constraints: beside V Vᵀ as JAX takes it, and NumPy's.

    OMP_NUM_THREADS=1 python benchmarks/jax_directions.py [--parameters 100000,1000000] [--repeats 15]
        [--out benchmarks/results]

Limitations: one machine, whatever else it does at the time; wall time, the least of the repeats, which run in turns.
Nothing is said of compiling, nor of GPUs. float64 is enabled; the dtype is the gradients'.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tables import machine, publish, read_arguments, table

from cpgrl_opt import ConstrainedStep
from cpgrl_opt.jax import constrained_direction

STEP = ConstrainedStep(formulation="linearized", step_size=1.0, restoration_rate=0.5)


@dataclass(frozen=True)
class Row:
    """Least milliseconds of each, and the worst residual of the directions."""

    problems: int
    n: int
    m: int
    dtype: str
    direction: float
    gramian: float
    textbook: float
    numpy: float
    error: float
    failed: int


def project(values: Any, V: Any) -> Any:
    """The textbook's."""
    g, J = V[0], V[1:]
    return g + jnp.maximum(jnp.linalg.solve(J @ J.T, values[1:] - J @ g), 0.0) @ J


def time_in_turns(repeats: int, *runs: Callable[[], Any]) -> list[float]:
    """Least milliseconds of each."""
    times: list[list[float]] = [[] for _ in runs]
    for turn in range(repeats + 1):
        for run, found in zip(runs, times, strict=True):
            start = time.perf_counter()
            jax.block_until_ready(run())
            if turn:  # the first compiles
                found.append(1e3 * (time.perf_counter() - start))
    return [min(found) for found in times]


def measure(problems: int, n: int, m: int, dtype: str, repeats: int) -> Row:
    """One shape; problems = 1 without `vmap`."""
    rng = np.random.default_rng(n)
    batch = () if problems == 1 else (problems,)
    values = jnp.asarray(0.3 * rng.normal(size=(*batch, 1 + m)))
    A = rng.normal(size=(*batch, 1 + m, n)).astype(dtype)
    V, repeat = jnp.asarray(A), jax.vmap if batch else (lambda function: function)
    solve = jax.jit(repeat(partial(constrained_direction, thresholds=np.zeros(m), step=STEP)))
    textbook, gramian = jax.jit(repeat(project)), jax.jit(repeat(lambda V: V @ V.T))
    runs = (
        lambda: solve(values, V),
        lambda: gramian(V),
        lambda: textbook(values, V),
        lambda: A @ A.swapaxes(-1, -2),
    )
    times, info = time_in_turns(repeats, *runs), solve(values, V)[1]
    failed = int((np.asarray(info.status) != 0).sum())
    return Row(problems, n, m, dtype, *times, float(np.max(info.residuals)), failed)


def rows(parameters: list[int], repeats: int) -> Iterator[Row]:
    """All shapes."""
    for n, m in ((9, 3), (20, 5)):
        yield measure(64, n, m, "float64", 10 * repeats)
    for n in parameters:
        for dtype in ("float64", "float32"):
            yield measure(1, n, 5, dtype, repeats)


def main() -> None:
    """Measures, prints and writes."""
    arguments = read_arguments(__doc__, parameters=[100_000, 1_000_000], repeats=15)
    jax.config.update("jax_enable_x64", True)
    found = list(rows(arguments.parameters, arguments.repeats))
    heads = "| problems | n | m | dtype | ms | V Vᵀ by JAX | textbook | V Vᵀ by NumPy | worst residual | failed |"
    line = (
        "| {0.problems} | {0.n:.0e} | {0.m} | {0.dtype} | {0.direction:.3g} | {0.gramian:.3g} | {0.textbook:.3g} | "
        "{0.numpy:.3g} | {0.error:.0e} | {0.failed} |"
    )
    about = "Least wall time of a certified direction under `jit`, in turns with what stands beside it."
    parts = [about, table(heads, line, found), f"{machine('jax')}."]
    publish(arguments, "Directions in JAX", parts, found)


if __name__ == "__main__":
    main()
