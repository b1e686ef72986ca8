"""Of B problems at once, how many does a batched solver answer a second, and how many of its answers are right?

B problems of n parameters and m rows, standard normal, with bounds that about half of the rows miss; then (c g, c J,
c² b) for c = 1, 1e-4, 1e-8: the directions are c times as long, and an absolute tolerance calls anything solved. Right
is what lies within 1e-6 of the exact core's direction, in units of the longer of g and d: by `active-set` on NumPy's
arrays, certified to 1e-9; itself it stands in the table for its speed. Times are those of a whole call on arrays that
lie where the solver wants them, with its checks and its certificate, where it has one.

- ours: NumPy's batch; `cpgrl_opt.torch.solve_batch` of tensors in float64 and float32, on the CPU, where it is NumPy's
  batch again, and on a GPU where there is one; and the GPU's way with tensors of the CPU.
- qpax: `solve_qp` under `vmap` and `jit`, float64, as it comes and at a tolerance of 1e-9. Moreau: `CompiledSolver`, as
  it comes.

    OMP_NUM_THREADS=1 python benchmarks/batches.py [--problems 4096] [--parameters 20] [--constraints 5]
        [--repeats 5] [--out benchmarks/results]

Limitations: one machine, whatever else it does at the time; wall time, the least of the repeats. One shape and one kind
of problems, rows well apart. What is not installed is missing, and said to be.
"""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import numpy as np
from tables import machine, publish, read_arguments, table

from cpgrl_opt import ProblemBatch, solve_batch

SCALES, RIGHT = (1.0, 1e-4, 1e-8), 1e-6
Answer = Callable[[], Any]  # the directions, (B, n)


@dataclass(frozen=True)
class Row:
    """One solver at one scale; right: the share of its answers; seconds of a batch."""

    method: str
    device: str
    scale: float
    problems: int
    n: int
    m: int
    seconds: float
    per_second: float
    right: float
    worst: float  # distance of the answers that are right


def draw(count: int, n: int, m: int, scale: float) -> ProblemBatch:
    """The same problems at each scale."""
    rng = np.random.default_rng(0)
    g, J, b = rng.standard_normal((count, n)), rng.standard_normal((count, m, n)), rng.standard_normal((count, m))
    return ProblemBatch(scale * g, scale * J, scale**2 * math.sqrt(n) * b)


def ours(problems: ProblemBatch) -> Iterator[tuple[str, str, Answer]]:
    """NumPy's batch, and tensors where PyTorch is installed."""
    g, J, b, _ = problems.arrays()
    yield "NumPy batch", "cpu", lambda: solve_batch("active-set", ProblemBatch(g, J, b)).value
    try:
        import torch

        from cpgrl_opt.torch import batch
    except ImportError:
        print("SKIP torch: not installed, its lines are missing")
        return
    torch.set_num_threads(1)
    for device in ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]:
        for dtype in (torch.float64, torch.float32):
            given = [torch.tensor(each, dtype=dtype, device=device) for each in (g, J)]
            kind = str(dtype).removeprefix("torch.")

            def solve(given: Any = given) -> Any:
                return batch.solve_batch(*given, b).value

            def solve_apart(given: Any = given) -> Any:
                with patch.object(batch, "is_apart", lambda _: True):
                    return batch.solve_batch(*given, b).value

            yield f"tensors, {kind}", device, solve
            if device == "cpu":
                yield f"tensors, {kind}, as on a GPU", device, solve_apart


def qpax(problems: ProblemBatch) -> Iterator[tuple[str, str, Answer]]:
    """An interior-point method under `vmap`."""
    try:
        import jax
        import qpax as library
    except ImportError:
        print("SKIP qpax: not installed, its lines are missing")
        return
    jax.config.update("jax_enable_x64", True)
    g, J, b = (jax.numpy.asarray(each) for each in problems.arrays()[:3])
    n = g.shape[1]
    eye, none = jax.numpy.eye(n), (jax.numpy.zeros((0, n)), jax.numpy.zeros(0))
    for name, settings in (("qpax", {}), ("qpax, solver_tol=1e-9", {"solver_tol": 1e-9})):

        def solve(settings: Any = settings) -> Any:
            return jax.vmap(lambda g, J, b: library.solve_qp(eye, -g, *none, -J, -b, **settings)[0])(g, J, b)

        yield name, jax.default_backend(), jax.jit(solve)


def moreau(problems: ProblemBatch) -> Iterator[tuple[str, str, Answer]]:
    """A conic interior-point method, compiled for the structure."""
    try:
        import moreau as library
    except ImportError:
        print("SKIP moreau: not installed, its lines are missing")
        return
    g, J, b, _ = problems.arrays()
    count, m, n = J.shape
    structure = {
        "P_row_offsets": list(range(n + 1)),
        "P_col_indices": list(range(n)),
        "A_row_offsets": [i * n for i in range(m + 1)],
        "A_col_indices": m * list(range(n)),
    }
    for device in library.available_devices():
        settings = library.Settings(device=device, batch_size=count)
        solver = library.CompiledSolver(
            n=n, m=m, **structure, cones=library.Cones(num_nonneg_cones=m), settings=settings
        )

        def solve(solver: Any = solver) -> Any:
            solver.setup(np.ones((count, n)), -J.reshape(count, -1))
            return solver.solve(-g, -b).x

        yield "Moreau", device, solve


def _host(found: Any) -> np.ndarray:
    return np.asarray(found.cpu() if hasattr(found, "cpu") else found)


def measure(problems: ProblemBatch, scale: float, repeats: int) -> Iterator[Row]:
    """All that are installed, at one scale."""
    count, m, n = problems.jacobian.shape
    expected = solve_batch("active-set", problems)
    unit = np.maximum(*(np.linalg.norm(each, axis=1) for each in (problems.gradient, expected.value)))
    for contenders in (ours, qpax, moreau):
        for method, device, solve in contenders(problems):
            times, found = [], _host(solve())  # what is compiled is compiled here
            for _ in range(repeats):
                start = time.perf_counter()
                found = _host(solve())  # which waits for a device
                times.append(time.perf_counter() - start)
            found = found.astype(np.float64)
            apart = np.linalg.norm(found - expected.value, axis=1) / unit
            right = apart <= RIGHT
            worst = float(apart[right].max(initial=0.0))
            yield Row(method, device, scale, count, n, m, min(times), count / min(times), float(right.mean()), worst)


def main() -> None:
    """Measures, prints and writes."""
    arguments = read_arguments(__doc__, problems=4096, parameters=20, constraints=5, repeats=5)
    shape = arguments.problems, arguments.parameters, arguments.constraints
    rows = [row for scale in SCALES for row in measure(draw(*shape, scale), scale, arguments.repeats)]
    heads = "| solver | device | scale | problems a second | right | worst of these |"
    line = "| {0.method} | {0.device} | {0.scale:g} | {0.per_second:.2e} | {0.right:.2%} | {0.worst:.0e} |"
    about = "{} problems of n = {} and m = {}; right is within {:g} of the certified direction.".format(*shape, RIGHT)
    publish(arguments, "Batches of problems", [about, table(heads, line, rows), f"{machine()}."], rows)


if __name__ == "__main__":
    main()
