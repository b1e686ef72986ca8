"""Actor and critics on CartPole, CPO's update for two costs: a critic head a channel, and a natural gradient.

    python examples/torch_actor_critic.py

The trust region is a ball in the Fisher metric, which is known by its products with vectors. Needs the extra `torch`.
It takes about ten seconds.
"""

from dataclasses import replace

import gymnasium
import torch

from cpgrl_opt import ConstrainedStep
from cpgrl_opt.torch import constrained_backward

LIMITS = {"drift": 0.15, "speed": 0.35}  # means over a step of |position|, m, and |velocity|, m/s
AIM = {name: 0.9 * limit for name, limit in LIMITS.items()}  # since 32 episodes tell a mean to a tenth or so
EPISODES, STEPS, DISCOUNT = 32, 100, 0.97
STEP = ConstrainedStep(formulation="linearized", restoration_rate=0.5, radius=0.1, metric_tolerance=1e-8)


@torch.no_grad()
def play(envs, policy, seed):
    """States, one more than actions, and whether an episode is still going on, (steps, episodes, …)."""
    state, _ = envs.reset(seed=seed)
    states, actions, alive = [torch.tensor(state).double()], [], [torch.ones(EPISODES, dtype=torch.bool)]
    while alive[-1].any() and len(actions) < STEPS:
        actions.append(torch.multinomial(policy(states[-1]).softmax(dim=-1), 1)[:, 0])
        state, _, failed, _, _ = envs.step(actions[-1].numpy())
        states.append(torch.tensor(state).double())
        alive.append(alive[-1] & ~torch.tensor(failed))
    return torch.stack(states), torch.stack(actions), torch.stack(alive)


def advantages(rewards, values, alive, trace=0.95):
    """Generalized advantage estimates of all channels at once; rewards: (steps, episodes, channels)."""
    errors = (rewards + DISCOUNT * values[1:] * alive[1:, :, None] - values[:-1]) * alive[:-1, :, None]
    found, ahead = torch.zeros_like(errors), 0.0
    for t in reversed(range(len(errors))):
        found[t] = ahead = errors[t] + DISCOUNT * trace * ahead
    return found


def fisher(policy, states, damping=0.01):
    """v ↦ (F + damping I) v: the second derivative of the divergence from the policy as it is."""
    parameters, logs = [*policy.parameters()], policy(states).log_softmax(dim=-1)
    divergence = (logs.detach().exp() * (logs.detach() - logs)).sum(dim=-1).mean()
    slopes = torch.autograd.grad(divergence, parameters, create_graph=True)

    def multiply(v):
        products = torch.autograd.grad(slopes, parameters, v, retain_graph=True)
        return [product + damping * part for product, part in zip(products, v)]

    return multiply


def train(updates=40, seed=0, report=print):
    """Trains a policy; returns how long the last episodes were, and the mean costs of the last ten updates."""
    torch.manual_seed(seed)
    envs = gymnasium.make_vec("CartPole-v1", num_envs=EPISODES, vectorization_mode="vector_entry_point")
    policy = torch.nn.Sequential(torch.nn.Linear(4, 16), torch.nn.Tanh(), torch.nn.Linear(16, 2)).double()
    critics = torch.nn.Sequential(torch.nn.Linear(4, 32), torch.nn.Tanh(), torch.nn.Linear(32, 3)).double()
    learn, move = (
        torch.optim.Adam(critics.parameters(), lr=0.01),
        torch.optim.SGD(policy.parameters(), lr=STEP.step_size),
    )
    history = []
    for update in range(updates):
        states, actions, alive = play(envs, policy, 1000 * seed + update)
        on, rewards = alive[:-1], torch.cat([torch.ones_like(states[1:, :, :1]), states[1:, :, :2].abs()], dim=-1)
        advantage = advantages(rewards, critics(states).detach(), alive)
        target = advantage + critics(states[:-1]).detach()
        for _ in range(20):
            learn.zero_grad()
            (critics(states[:-1]) - target)[on].square().mean().backward()
            learn.step()

        centred = advantage[on] - advantage[on].mean(dim=0)
        logs = policy(states[:-1][on]).log_softmax(dim=-1).gather(-1, actions[on][:, None])
        loss, *costs = (logs * centred).mean(dim=0) * torch.tensor([-1.0, 1.0, 1.0])
        values = dict(zip(LIMITS, rewards[on][:, 1:].mean(dim=0)))
        move.zero_grad()
        info = constrained_backward(
            loss,
            dict(zip(LIMITS, costs)),
            values=values,
            thresholds=AIM,
            parameters=policy.parameters(),
            step=replace(STEP, metric=fisher(policy, states[:-1][on][::5])),
        )
        move.step()

        history.append([values[name].item() for name in LIMITS])
        length = on.sum(dim=0).double().mean().item()
        if update % 10 == 9:
            told = ", ".join(f"{name} {values[name]:.3f} (≤ {limit})" for name, limit in LIMITS.items())
            report(f"update {update + 1}: {length:.0f} steps, {told}, {info.status.name}")
    return length, dict(zip(LIMITS, torch.tensor(history[-10:]).mean(dim=0).tolist()))


if __name__ == "__main__":
    train()
