"""GPOMDP: its long-run limit is the linear solve's, and its bias what the docstring says."""

import numpy as np
import pytest

from envs import ThreeStateMDP, random_mdp
from rl import GPOMDP, SoftmaxTable

from .stand_ins import streams

MDPS = {"three-state": ThreeStateMDP(), "six channels": random_mdp(np.random.default_rng(1), 4, 3, 6)}


def assert_mean(samples: np.ndarray, expected: np.ndarray, errors: float, bias: float = 0.0) -> None:
    """The mean over the first axis lies within `errors` standard errors (+ a known bias) of what is expected."""
    standard = samples.std(axis=0, ddof=1) / np.sqrt(len(samples))
    distance = np.abs(samples.mean(axis=0) - expected)
    worst = np.max((distance - bias) / np.maximum(standard, 1e-12))
    assert worst <= errors, f"{worst:.1f} standard errors off"


@pytest.mark.parametrize("weights", ["paper", "usual"])
@pytest.mark.parametrize("decay", [0.5, 0.99])
@pytest.mark.parametrize("case", MDPS)
def test_long_episodes_tend_to_the_linear_solve_at_beta(case: str, decay: float, weights: str) -> None:
    """Within six standard errors over 40 runs of 20000 steps, plus a transient below 2/(T(1 − β))·max |r|."""
    mdp = MDPS[case]
    settings = GPOMDP(weights=weights, steps=20_000, trace_decay=decay)
    policy, runs = SoftmaxTable(mdp.states, mdp.actions, np.random.default_rng(3).random(mdp.states * mdp.actions)), 40
    estimate = settings.start(mdp, policy, streams(runs)).episode(np.tile(policy.parameters, (runs, 1)))
    limit = mdp.discounted_score_gradients(policy.probabilities(), decay, weights)
    transient = 2 / (settings.steps * (1 - decay)) * np.abs(mdp.rewards).max()
    assert_mean(estimate.gradients, limit.reshape(mdp.reward_channels, -1), 6, transient)
    assert_mean(estimate.values, mdp.average_rewards(policy.probabilities()), 6)


def test_the_bias_of_the_trace_decay_is_what_the_docstring_says() -> None:
    """Three-state MDP, 1000 policies θ ~ U[0, 1]⁹: ‖limit − exact‖ / ‖exact‖ per channel, at β = 0.9, 0.99, 0.999."""
    mdp, theta = ThreeStateMDP(), np.random.default_rng(0).random((1000, 9))
    pi = SoftmaxTable(3, 3).probabilities(theta)
    exact = mdp.policy_gradients(pi)
    for weights, bounds in {"paper": (0.014, 0.0014, 0.00014), "usual": (0.064, 0.0065, 0.00065)}.items():
        for decay, bound in zip((0.9, 0.99, 0.999), bounds, strict=True):
            error = mdp.discounted_score_gradients(pi, decay, weights) - exact
            ratio = np.linalg.norm(error, axis=(2, 3)) / np.linalg.norm(exact, axis=(2, 3))
            assert 0.8 * bound < ratio.max() < 1.01 * bound
