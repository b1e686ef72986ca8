"""A training loop of one model in parts, on ranks of gloo: python ranks.py RANK FOLDER writes what it came to."""

import pickle
import sys
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cpgrl_opt import ConstrainedStep
from cpgrl_opt.vectors import gather_by_torch

COUNT, UPDATES = 4, 8
STEP = ConstrainedStep(formulation="linearized", step_size=0.2, restoration_rate=0.5)


def train(way: str, rank: int, few: int, group: Any) -> tuple[np.ndarray, list[np.ndarray]]:
    """Logistic regression on 12 features, of which each rank has its own; two costs. The part, and all multipliers."""
    import torch  # here, since whoever collects tests imports this file

    from cpgrl_opt.torch import ConstrainedOptimizer, constrained_backward

    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(60, 12)), rng.random(60) < 0.5
    mine, target = torch.from_numpy(x).tensor_split(few, dim=1)[rank], torch.from_numpy(y).double()
    w = torch.nn.Parameter(torch.zeros(mine.shape[1], dtype=torch.float64))
    gather, told = partial(gather_by_torch, group=group), []
    optimizer: Any = torch.optim.SGD([w], lr=0.2)
    if way == "optimizer":
        optimizer = ConstrainedOptimizer(torch.optim.Adam([w], lr=0.05), STEP, gather=gather)
    for _ in range(UPDATES):
        part = mine @ w
        whole = part.detach().clone()
        torch.distributed.all_reduce(whole, group=group)
        score = whole + (part - part.detach())  # the sum of all parts, with the gradient of this one
        loss = torch.nn.functional.binary_cross_entropy_with_logits(score, target)
        costs = {"mean": -score.mean(), "first": score[:20].mean()}
        limits = {"mean": -0.05, "first": 0.02}
        optimizer.zero_grad()
        if way == "optimizer":
            optimizer.constrain(costs, thresholds=limits)
            loss.backward()
        else:
            info = constrained_backward(loss, costs, thresholds=limits, parameters=[w], step=STEP, gather=gather)
        optimizer.step()
        info = optimizer.info if way == "optimizer" else info
        told.append(np.array([*info.multipliers.values(), *info.predicted_slack.values()]))
    return w.detach().numpy(), told


def work(rank: int, folder: Path) -> None:
    from torch import distributed

    start = f"file://{folder}/meeting"
    distributed.init_process_group(
        "gloo", init_method=start, rank=rank, world_size=COUNT, timeout=timedelta(seconds=300)
    )
    found = {}
    for few in (1, 2, 4):
        group = distributed.new_group(list(range(few)))
        if rank < few:
            found.update({(way, few): train(way, rank, few, group) for way in ("backward", "optimizer")})
    distributed.barrier()
    (folder / f"{rank}.pickle").write_bytes(pickle.dumps(found))


if __name__ == "__main__":
    work(int(sys.argv[1]), Path(sys.argv[2]))
