"""One process of several that `test_vectors_of_several_processes` starts: RANK COUNT FOLDER."""

import os
import pickle
import sys
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cpgrl_opt import SOLVERS, ConstrainedStep, Direction, DirectionProblem, Linearization, Status, kkt_residuals, solve
from cpgrl_opt.vectors import Sharded, gather_by_torch

VALUES = [0.0, -0.5, 0.25, -1.0]
# What a call says on the rank where its argument is wrong.
WRONG = {
    "dtype of g": "gradient should be an array of real numbers; found dtype complex128",
    "length of bound": "bound should have shape (3,); found (2,)",
    "radius": "radius should be a finite number > 0; found -1.0",
    "metric": "metric should be None where gradient is an object",
    "NaN in values": "values should be finite; found nan",
    "thresholds": "thresholds should have shape (3,); found (2,)",
    "metric of a step": "metric should be None where gradient is an object",
    "solver that breaks": "no memory left",
    "solver of a step that breaks": "no memory left",
    "multipliers": "direction.multipliers should have shape (3,); found (4,)",
}


class Breaks:
    """A solver that does."""

    def solve(self, problem: DirectionProblem) -> Direction:  # noqa: ARG002
        raise MemoryError("no memory left")


def call(what: str, wrong: bool, g: Any, J: Any, gather: Any) -> Any:
    """What the call named gives, with an argument that is wrong or right."""
    if what == "dtype of g":
        return Sharded(g * 1j if wrong else g, J, gather=gather)
    vectors, some, three = Sharded(g, J, gather=gather), np.zeros(2 + (not wrong)), np.zeros(3)
    if what == "solver of a step that breaks":
        return ConstrainedStep(solver=Breaks() if wrong else "active-set")(Linearization(VALUES, vectors), three)
    if what in ("thresholds", "metric of a step"):
        step = ConstrainedStep(metric=np.ones(len(g)) if what.startswith("metric") and wrong else None)
        return step(Linearization(VALUES, vectors), some if what == "thresholds" else three)
    if what == "NaN in values":
        return Linearization([np.nan, *VALUES[1:]] if wrong else VALUES, vectors)
    if what == "solver that breaks":
        return solve(DirectionProblem(vectors), Breaks() if wrong else SOLVERS["active-set"])
    if what == "multipliers":
        problem, mu = DirectionProblem(vectors), np.zeros(3 + wrong)
        return kkt_residuals(problem, Direction(problem.vectors.zero(), mu, Status.OPTIMAL))
    others = {"length of bound": {"bound": some}, "radius": {"radius": -1.0}, "metric": {"metric": np.ones(len(g))}}
    return DirectionProblem(vectors, **(others[what] if wrong else {}))


def part(rank: int, count: int) -> tuple[Any, Any]:
    import torch  # here, since whoever collects tests imports this file

    V = torch.from_numpy(np.random.default_rng(0).integers(-9, 10, (4, 40)) / 8.0)
    mine = V.tensor_split(count, dim=1)[rank]
    return mine[0], mine[1:]


def work(rank: int, count: int, folder: Path) -> None:
    from torch import distributed

    distributed.init_process_group(
        "gloo", init_method=f"file://{folder}/meeting", rank=rank, world_size=count, timeout=timedelta(seconds=30)
    )
    found: dict[str, Any] = {"answers": {}, "wrong": {}}
    for few in (1, 2, 4):
        group = distributed.new_group(list(range(few)))
        if rank < few:
            vectors = Sharded(*part(rank, few), gather=partial(gather_by_torch, group=group))
            found["answers"][few] = solve(DirectionProblem(vectors, bound=0.25))
    pair = distributed.new_group([0, 1], timeout=timedelta(seconds=10))  # who waits so long would wait for ever
    g, J = (each.numpy() for each in part(rank % 2, 2))
    for what in WRONG if rank < 2 else ():
        try:
            call(what, rank == 1, g, J, partial(gather_by_torch, group=pair))
        except Exception as error:
            found["wrong"][what] = f"{type(error).__name__}: {error}"
    g, J = part(rank, count)
    try:
        DirectionProblem(Sharded(g, J.clone().fill_(np.nan) if rank == 1 else J))
    except ValueError as error:
        found["nan"] = str(error)
    vectors = Sharded(g, J)
    if rank < 3:
        try:
            solve(DirectionProblem(vectors))
        except RuntimeError as error:
            found["died"] = RuntimeError.__name__ if isinstance(error, RuntimeError) else ""
    (folder / f"{rank}.pickle").write_bytes(pickle.dumps(found))
    os._exit(0)  # rank 3 is gone here, in the middle of a solve; the others have nothing more to say


if __name__ == "__main__":
    work(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
