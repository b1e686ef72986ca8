"""Training loops on ranks of gloo, several kinds in one launch: python ranks.py FOLDER writes what they came to.

The ranks are forked from one process that has imported PyTorch and loaded the kernels: each alone would take as long.
"""

import multiprocessing
import pickle
import sys
import time
from collections.abc import Callable
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cpgrl_opt import ConstrainedStep, DirectionProblem, solve
from cpgrl_opt.vectors import gather_by_torch

COUNT, UPDATES = 4, 8
KINDS, WAYS = ("parts", "averaged", "sharded"), ("backward", "optimizer")
STEP = ConstrainedStep(formulation="linearized", step_size=0.2, restoration_rate=0.5)
LIMITS = {"mean": -0.05, "first": 0.02}


def draw() -> tuple[Any, Any]:
    """Sixty samples of 12 features, and what they are."""
    import torch  # here, since whoever collects tests imports this file

    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(60, 12)), rng.random(60) < 0.5
    return torch.from_numpy(x), torch.from_numpy(y).double()


def train(way: str, parameters: list[Any], losses: Callable[[], Any], settings: dict[str, Any]) -> list[np.ndarray]:
    """All multipliers and predicted slack. losses: () → the loss, and two costs by name."""
    import torch

    from cpgrl_opt.torch import ConstrainedOptimizer, constrained_backward

    told = []
    optimizer: Any = torch.optim.SGD(parameters, lr=0.2)
    if way == "optimizer":
        optimizer = ConstrainedOptimizer(torch.optim.Adam(parameters, lr=0.05), STEP, **settings)
    for _ in range(UPDATES):
        loss, costs = losses()
        optimizer.zero_grad()
        if way == "optimizer":
            optimizer.constrain(costs, thresholds=LIMITS)
            loss.backward()
        else:
            info = constrained_backward(loss, costs, thresholds=LIMITS, parameters=parameters, step=STEP, **settings)
        optimizer.step()
        info = optimizer.info if way == "optimizer" else info
        told.append(np.array([*info.multipliers.values(), *info.predicted_slack.values()]))
    return told


def in_parts(way: str, rank: int, few: int, group: Any) -> tuple[np.ndarray, list[np.ndarray]]:
    """Logistic regression, of whose features each rank has its own. The part of θ on this rank, and what was told."""
    import torch

    x, target = draw()
    mine = x.tensor_split(few, dim=1)[rank]
    w = torch.nn.Parameter(torch.zeros(mine.shape[1], dtype=torch.float64))

    def losses() -> Any:
        part = mine @ w
        whole = part.detach().clone()
        torch.distributed.all_reduce(whole, group=group)
        score = whole + (part - part.detach())  # the sum of all parts, with the gradient of this one
        loss = torch.nn.functional.binary_cross_entropy_with_logits(score, target)
        return loss, {"mean": -score.mean(), "first": score[:20].mean()}

    told = train(way, [w], losses, {"gather": partial(gather_by_torch, group=group)})
    return w.detach().numpy(), told


def on_shares(kind: str, way: str, rank: int, few: int, group: Any) -> tuple[np.ndarray, list[np.ndarray]]:
    """A network, of whose data each rank has its own: θ whole on each, or sharded. The whole θ, and what was told."""
    import torch

    from cpgrl_opt.torch import average_over_ranks

    x, target = (each.tensor_split(few)[rank] for each in draw())
    is_first = (torch.arange(60) < 20).tensor_split(few)[rank]
    torch.manual_seed(0)
    net = torch.nn.Sequential(torch.nn.Linear(12, 5), torch.nn.Tanh(), torch.nn.Linear(5, 1)).double()
    settings: dict[str, Any] = {}
    forward: Any = net
    if kind == "sharded":
        from torch.distributed.device_mesh import DeviceMesh
        from torch.distributed.fsdp import fully_shard

        fully_shard(net, mesh=DeviceMesh.from_group(group, "cpu"))
    else:
        settings = {"average": partial(average_over_ranks, group=group)}
        if way == "optimizer":  # whose loss.backward() is averaged by PyTorch
            forward = torch.nn.parallel.DistributedDataParallel(net, process_group=group)

    def losses() -> Any:
        score = forward(x)[:, 0]
        loss = torch.nn.functional.binary_cross_entropy_with_logits(score, target)
        return loss, {"mean": -score.mean(), "first": 3.0 * (score * is_first).mean()}

    told = train(way, [*net.parameters()], losses, settings)
    whole = [each.full_tensor() if kind == "sharded" else each for each in net.parameters()]
    return torch.cat([each.detach().reshape(-1) for each in whole]).numpy(), told


def heads_of_one_rank(rank: int) -> list[Any]:
    """Gradients of heads that all ranks use, the last alone, and none; averaged over all."""
    import torch

    from cpgrl_opt.torch import average_over_ranks, constrained_backward

    heads = [torch.nn.Parameter(torch.ones(2, dtype=dtype)) for dtype in (torch.float64, torch.float32, torch.float64)]
    used = heads[:2] if rank == COUNT - 1 else heads[:1]
    loss = sum((1.0 + rank) * each.sum() for each in used)
    settings: dict[str, Any] = {"parameters": heads, "step": STEP, "average": average_over_ranks}
    constrained_backward(loss, [(heads[0].sum() - rank).square()], thresholds=[99.0], **settings)
    return [None if each.grad is None else each.grad.tolist() for each in heads]


def errors_of_one_rank(rank: int) -> list[str]:
    """What all are told where one has no finite gradient: on a share of the data, in a part of the model."""
    import torch

    from cpgrl_opt.torch import ConstrainedOptimizer, average_over_ranks, constrained_backward

    w = torch.nn.Parameter(torch.ones(2))
    factor, told = torch.nan if rank == 1 else 1.0, []
    settings: dict[str, Any] = {"values": [0.0], "thresholds": [9.0]}
    for optimizer in (None, ConstrainedOptimizer(torch.optim.SGD([w], lr=0.1), STEP, gather=gather_by_torch)):
        try:
            if optimizer is not None:
                optimizer.constrain([factor * w.sum()], **settings)
            else:
                settings["average"] = average_over_ranks
                constrained_backward(w.sum(), [factor * w.sum()], parameters=[w], step=STEP, **settings)
        except ValueError as error:
            told.append(str(error))
        settings.pop("average", None)
    return told


def work(rank: int, folder: Path) -> None:
    from torch import distributed

    start = f"file://{folder}/meeting"
    distributed.init_process_group(
        "gloo", init_method=start, rank=rank, world_size=COUNT, timeout=timedelta(seconds=100)
    )
    found: dict[Any, Any] = {"heads": heads_of_one_rank(rank), "errors": errors_of_one_rank(rank)}
    for few in (1, 2, 4):
        group = distributed.new_group(list(range(few)))
        if rank < few:
            for way in WAYS:
                found["parts", way, few] = in_parts(way, rank, few, group)
                for kind in KINDS[1:]:
                    found[kind, way, few] = on_shares(kind, way, rank, few, group)
    distributed.barrier()
    (folder / f"{rank}.pickle").write_bytes(pickle.dumps(found))


def load() -> None:
    """What each rank would import, and compile or read from a disk."""
    import torch
    import torch.distributed.fsdp

    import cpgrl_opt.torch  # noqa: F401

    for n in (4, 80_000):
        tree = [torch.ones(n, dtype=torch.float64)]
        solve(DirectionProblem(tree, [[-tree[0]], [tree[0].cumsum(0)]], 1.0))


if __name__ == "__main__":
    load()
    fork = multiprocessing.get_context("fork")
    ranks = [fork.Process(target=work, args=(rank, Path(sys.argv[1]))) for rank in range(COUNT)]
    for each in ranks:
        each.start()
    while any(each.is_alive() for each in ranks):  # where one fails the others would wait for it
        if any(each.exitcode for each in ranks):
            for each in ranks:
                each.terminate()
        time.sleep(0.1)
    sys.exit(max(abs(each.exitcode or 0) for each in ranks))
