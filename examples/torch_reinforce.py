"""REINFORCE on CartPole with two costs: stay up, but keep the cart near the middle, and slow.

    python examples/torch_reinforce.py         the step's own gradient, in the place of loss.backward()
    python examples/torch_reinforce.py adam    Adam, whose every proposal is projected

Needs the extra `torch`. It takes a few seconds.
"""

import sys

import gymnasium
import torch

from cpgrl_opt import ConstrainedStep
from cpgrl_opt.torch import ConstrainedOptimizer, constrained_backward

LIMITS = {"drift": 0.15, "speed": 0.35}  # means over an episode of |position|, m, and |velocity|, m/s
AIM = {name: 0.9 * limit for name, limit in LIMITS.items()}  # since 32 episodes tell a mean to a tenth or so
EPISODES, STEPS = 32, 100
STEP = ConstrainedStep(formulation="linearized", step_size=0.02, restoration_rate=0.3, max_restoration=0.2)


@torch.no_grad()
def play(envs, net, seed):
    """States, actions, and whether an episode is still going on, (steps, episodes, …)."""
    state, _ = envs.reset(seed=seed)
    alive, columns = torch.ones(EPISODES, dtype=torch.bool), []
    while alive.any() and len(columns) < STEPS:
        now = torch.tensor(state)
        action = torch.multinomial(net(now).softmax(dim=-1), 1)[:, 0]
        columns.append((now, action, alive))
        state, _, failed, _, _ = envs.step(action.numpy())
        alive = alive & ~torch.tensor(failed)
    return map(torch.stack, zip(*columns))


def surrogate(log_probabilities, outcome):
    """A loss with the gradient of the mean outcome; a step's baseline is the mean over episodes."""
    return (log_probabilities * (outcome - outcome.mean(dim=-1, keepdim=True))).sum(dim=0).mean()


def train(way="backward", updates=80, seed=0, report=print):
    """Trains a policy; returns how long the last episodes were, and the mean costs of the last ten updates."""
    torch.manual_seed(seed)
    envs = gymnasium.make_vec("CartPole-v1", num_envs=EPISODES, vectorization_mode="vector_entry_point")
    net = torch.nn.Sequential(torch.nn.Linear(4, 16), torch.nn.Tanh(), torch.nn.Linear(16, 2))
    if way == "adam":
        optimizer = ConstrainedOptimizer(torch.optim.Adam(net.parameters(), lr=0.02), STEP)
    else:
        optimizer = torch.optim.SGD(net.parameters(), lr=STEP.step_size)
    history = []
    for update in range(updates):
        states, actions, alive = play(envs, net, 1000 * seed + update)
        length = alive.sum(dim=0)
        to_go = alive.flip(0).cumsum(dim=0).flip(0).float()
        costs = (states[..., :2].abs() * alive[..., None]).sum(dim=0) / length[:, None]  # of each episode

        logs = net(states).log_softmax(dim=-1).gather(-1, actions[..., None])[..., 0] * alive
        loss = -surrogate(logs, to_go) / 10.0
        constraints = {name: surrogate(logs, cost) for name, cost in zip(LIMITS, costs.T)}
        values = dict(zip(LIMITS, costs.mean(dim=0)))
        optimizer.zero_grad()
        if way == "adam":
            optimizer.constrain(constraints, values=values, thresholds=AIM)
            loss.backward()
        else:
            info = constrained_backward(
                loss, constraints, values=values, thresholds=AIM, parameters=net.parameters(), step=STEP
            )
        optimizer.step()
        info = optimizer.info if way == "adam" else info

        history.append([values[name].item() for name in LIMITS])
        if update % 10 == 9:
            told = ", ".join(f"{name} {values[name]:.3f} (≤ {limit})" for name, limit in LIMITS.items())
            report(f"update {update + 1}: {length.float().mean():.0f} steps, {told}, {info.status.name}")
    return length.float().mean().item(), dict(zip(LIMITS, torch.tensor(history[-10:]).mean(dim=0).tolist()))


if __name__ == "__main__":
    train(*sys.argv[1:2])
