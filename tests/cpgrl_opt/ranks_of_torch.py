"""One process of several that `test_vectors_of_several_processes` starts: RANK COUNT FOLDER."""

import os
import pickle
import sys
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cpgrl_opt import DirectionProblem, solve
from cpgrl_opt.vectors import Sharded, gather_by_torch


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
    found: dict[str, Any] = {"answers": {}}
    for few in (1, 2, 4):
        group = distributed.new_group(list(range(few)))
        if rank < few:
            vectors = Sharded(*part(rank, few), gather=partial(gather_by_torch, group=group))
            found["answers"][few] = solve(DirectionProblem(vectors, bound=0.25))
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
