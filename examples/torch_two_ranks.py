"""One model in two processes, each with half of its parameters: no vector travels between them.

    python examples/torch_two_ranks.py

Logistic regression on 40 features, of which each rank of gloo has 20. What the ranks tell each other are the parts of
the scores, as in any model in parallel, and O(m²) inner products a step. Needs the extra `torch`.
"""

import sys
import tempfile

import torch

from cpgrl_opt import ConstrainedStep
from cpgrl_opt.torch import ConstrainedOptimizer
from cpgrl_opt.vectors import gather_by_torch

LIMITS = {"first": 0.1, "second": 0.1}  # mean scores of two kinds of people


def work(rank, count, meeting, updates=60):
    """What one rank does; both print nothing but what rank 0 says."""
    torch.distributed.init_process_group("gloo", init_method=f"file://{meeting}", rank=rank, world_size=count)
    torch.manual_seed(0)  # the same data on all ranks
    features, noise = torch.randn(500, 40), torch.randn(500)
    label = (features[:, :4].sum(dim=1) + noise > 0.0).float()
    mine = features.tensor_split(count, dim=1)[rank]
    weights = torch.nn.Parameter(torch.zeros(mine.shape[1]))
    step = ConstrainedStep(formulation="linearized", restoration_rate=0.5)
    optimizer = ConstrainedOptimizer(torch.optim.Adam([weights], lr=0.02), step, gather=gather_by_torch)
    for update in range(updates):
        part = mine @ weights
        whole = part.detach().clone()
        torch.distributed.all_reduce(whole)
        score = whole + (part - part.detach())  # the sum of all parts, with the gradient of this rank's
        loss = torch.nn.functional.binary_cross_entropy_with_logits(score, label)
        costs = {"first": score[features[:, 0] > 1.0].mean(), "second": -score[features[:, 1] < -1.0].mean()}
        optimizer.zero_grad()
        optimizer.constrain(costs, thresholds=LIMITS)
        loss.backward()
        optimizer.step()
        if rank == 0 and update % 20 == 19:
            told = ", ".join(f"{name} {cost:.3f} (≤ {LIMITS[name]})" for name, cost in costs.items())
            print(f"update {update + 1}: loss {loss:.3f}, {told}, {optimizer.info.status.name}", flush=True)
    torch.distributed.destroy_process_group()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        torch.multiprocessing.spawn(work, (2, f"{folder}/meeting", *map(int, sys.argv[1:2])), nprocs=2)
