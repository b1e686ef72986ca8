"""A classifier that treats two groups alike: not reinforcement learning, the same call.

    python examples/torch_fairness.py

Minimise the loss, while the mean scores of the groups differ by no more than 0.02 either way, and those who deserve a
yes get it with a mean score of at least 0.55 in each. Needs the extra `torch`. It takes a few seconds.
"""

import torch

from cpgrl_opt import ConstrainedStep
from cpgrl_opt.torch import ConstrainedOptimizer


def draw(count, seed):
    """Features, a label that depends on two of them, and a group that shifts one of these."""
    numbers = torch.Generator().manual_seed(seed)
    features = torch.randn(count, 5, generator=numbers)
    group = torch.rand(count, generator=numbers) < 0.4
    features[:, 0] += 0.8 * group
    chance = torch.sigmoid(1.5 * features[:, 0] - features[:, 1])
    return features, (torch.rand(count, generator=numbers) < chance).float(), group


def measure(net, features, label, group):
    """The loss, and what is constrained: the gap of the mean scores, and how sure it is of those it should choose."""
    logits = net(features)[:, 0]
    score = logits.sigmoid()
    loss = torch.nn.functional.binary_cross_entropy_with_logits(logits, label)
    gap = score[group].mean() - score[~group].mean()
    sure = [score[(label > 0.5) & each].mean() for each in (group, ~group)]
    return loss, {"gap": gap, "gap, other way": -gap, "unsure": 1.0 - sure[0], "unsure, others": 1.0 - sure[1]}


LIMITS = {"gap": 0.02, "gap, other way": 0.02, "unsure": 0.45, "unsure, others": 0.45}


def train(updates=150, seed=0, report=print):
    """Trains on 4000 people; returns loss and costs of these, and of 4000 others."""
    torch.manual_seed(seed)
    net = torch.nn.Sequential(torch.nn.Linear(5, 16), torch.nn.ReLU(), torch.nn.Linear(16, 1))
    step = ConstrainedStep(formulation="linearized", restoration_rate=0.2)
    optimizer = ConstrainedOptimizer(torch.optim.Adam(net.parameters(), lr=0.01), step)
    people, others = draw(4000, seed), draw(4000, seed + 1000)
    for update in range(updates):
        loss, costs = measure(net, *people)
        optimizer.zero_grad()
        optimizer.constrain(costs, thresholds=LIMITS)
        loss.backward()
        optimizer.step()
        if update % 30 == 29:
            told = ", ".join(f"{name} {cost:.3f} (≤ {LIMITS[name]})" for name, cost in costs.items())
            report(f"update {update + 1}: loss {loss:.3f}, {told}, {optimizer.info.status.name}")
    found = [measure(net, *each) for each in (people, others)]
    return [(loss.item(), {name: cost.item() for name, cost in costs.items()}) for loss, costs in found]


if __name__ == "__main__":
    print("others:", train()[1])
