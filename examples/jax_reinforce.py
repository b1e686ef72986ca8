"""REINFORCE under `jit`: a car that earns more when it drives fast, and may be hot in a tenth of its time only.

    python examples/jax_reinforce.py           the step's own gradient, in the place of the loss's
    python examples/jax_reinforce.py adam      Adam, whose every proposal is projected

Needs the extra `jax`. All updates are one compiled call; it takes a few seconds.
"""

import sys
from functools import partial

import jax
import jax.numpy as jnp
import optax

from cpgrl_opt import ConstrainedStep
from cpgrl_opt.jax import constrain, constrained_direction

COOL, HOT = 0, 2  # states; in between the car is warm
LIMIT = 0.1  # mean share of time that it is hot
AIM = 0.9 * LIMIT  # since 256 episodes tell a mean to a tenth or so
EPISODES, STEPS = 256, 32
STEP = ConstrainedStep(formulation="linearized", step_size=0.5, restoration_rate=0.3)


def drive(theta, key):
    """(steps,) states, actions (1 is fast), rewards and costs of an episode; log odds of fast are theta[state]."""

    def move(state, key):
        chance, slip = jax.random.split(key)
        fast = jax.random.bernoulli(chance, jax.nn.sigmoid(theta[state])).astype(int)
        cooled = jnp.where(jax.random.bernoulli(slip, 0.8), state - 1, state)
        after = jnp.clip(jnp.where(fast == 1, state + 1, cooled), COOL, HOT)
        return after, (state, fast, 1.0 + fast, (after == HOT) * 1.0)

    return jax.lax.scan(move, COOL, jax.random.split(key, STEPS))[1]


def estimate(theta, key):
    """The loss and the cost, (2,), and their gradients, (2, 3), by REINFORCE with what comes after each action."""
    states, fast, reward, cost = jax.vmap(partial(drive, theta))(jax.random.split(key, EPISODES))
    outcomes = jnp.stack([-reward, cost])  # a loss is minimised, a cost limited
    later = jnp.cumsum(outcomes[..., ::-1], axis=-1)[..., ::-1] / STEPS
    advantage = later - later.mean(axis=1, keepdims=True)

    def surrogates(theta):
        log_probability = jax.nn.log_sigmoid(jnp.where(fast == 1, theta[states], -theta[states]))
        return (log_probability * advantage).sum(axis=-1).mean(axis=-1)

    return outcomes.mean(axis=(1, 2)), jax.jacrev(surrogates)(theta)


def make_update(way):
    """(first state, update): what a way keeps from update to update, and (θ, state, estimates) → (θ, state, info)."""
    if way == "adam":
        optimizer = constrain(optax.adam(0.05), STEP, [AIM])

        def update(theta, state, values, gradients):
            rows = {"constraint_values": values[1:], "constraint_gradients": gradients[1:]}
            change, state = optimizer.update(gradients[0], state, theta, **rows)
            return theta + change, state, state.info

        return optimizer.init(jnp.zeros(3)), update

    def descend(theta, state, values, gradients):
        gradient, info = constrained_direction(values, gradients, [AIM], STEP)
        return theta - STEP.step_size * gradient, state, info

    return (), descend


@partial(jax.jit, static_argnums=(0, 1))
def run(way, updates, key):
    """θ, and the loss, the cost and the status of each update."""
    first, update = make_update(way)

    def learn(carry, key):
        theta, state = carry
        values, gradients = estimate(theta, key)
        theta, state, info = update(theta, state, values, gradients)
        return (theta, state), (values, info.status)

    start = jnp.full(3, 1.0), first  # rather fast: too hot
    (theta, _), history = jax.lax.scan(learn, start, jax.random.split(key, updates))
    return theta, history


def train(way="direction", updates=150, seed=0, report=print):
    """Trains a policy; returns the mean reward and cost a step of the last twenty updates, and the first cost."""
    theta, (values, status) = run(way, updates, jax.random.key(seed))
    for k in range(0, updates, 25):
        report(f"update {k:3d}: reward {-values[k, 0]:.3f}, hot {values[k, 1]:.3f} of {LIMIT}, status {status[k]}")
    reward, hot = -values[-20:, 0].mean(), values[-20:, 1].mean()
    odds = ", ".join(f"{chance:.2f}" for chance in jax.nn.sigmoid(theta))
    report(f"at the end: reward {reward:.3f}, hot {hot:.3f} of {LIMIT}; fast with chance {odds}")
    return float(reward), float(hot), float(values[0, 1])


if __name__ == "__main__":
    train(*sys.argv[1:2])
