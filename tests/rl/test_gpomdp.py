"""GPOMDP: its mean over episodes is the exact expectation; its long-run limit is the linear solve's."""

from dataclasses import replace

import numpy as np
import pytest

from envs import TabularEnv, TabularMDP, ThreeStateMDP, random_mdp
from rl import GPOMDP, SoftmaxTable
from rl.drivers import PythonDriver

from .stand_ins import streams

CASES = {"two states": (2, 2, 2), "six channels": (4, 3, 6), "twenty states": (20, 2, 4)}  # states, actions, channels

# --- the mean over many episodes ---------------------------------------------------------------------------------


def expected_estimate(mdp: TabularMDP, policy: SoftmaxTable, settings: GPOMDP) -> tuple[np.ndarray, np.ndarray]:
    """E ρ and E Δ after one episode from ρ = 0, exactly: p_t(s) and E[z_t; x_t = s] are propagated step by step."""
    pi, n = policy.probabilities(), policy.parameters.size
    scores = np.array([[policy.score(s, a) for a in range(policy.actions)] for s in range(policy.states)])
    p, trace = np.eye(mdp.states)[mdp.start], np.zeros((mdp.states, n))
    value, gradient = np.zeros(mdp.reward_channels), np.zeros((mdp.reward_channels, n))
    paper = settings.weights == "paper"
    updates = settings.steps - paper
    for t in range(settings.steps):
        joint = p[:, None] * pi
        carried = pi[:, :, None] * trace[:, None, :]
        following = settings.trace_decay * carried + joint[:, :, None] * scores
        met = carried + joint[:, :, None] * scores if paper else following
        if t > 0 or not paper:
            gradient += np.einsum("csa,san->cn", mdp.rewards, met) / updates
            value += settings.average_rate * (np.einsum("csa,sa->c", mdp.rewards, joint) - value)
        trace = np.einsum("san,saj->jn", following, mdp.transitions)
        p = np.einsum("sa,saj->j", joint, mdp.transitions)
    return value, gradient


def assert_mean(samples: np.ndarray, expected: np.ndarray, errors: float, bias: float = 0.0) -> None:
    """The mean over the first axis lies within `errors` standard errors (+ a known bias) of what is expected."""
    standard = samples.std(axis=0, ddof=1) / np.sqrt(len(samples))
    distance = np.abs(samples.mean(axis=0) - expected)
    worst = np.max((distance - bias) / np.maximum(standard, 1e-12))
    assert worst <= errors, f"{worst:.1f} standard errors off"


def delayed_rewards(delay: int = 4) -> TabularMDP:
    """What is done in state 0 is paid four steps later by ±1, and nothing else is: all of Δ¹ is the trace's."""
    states = 2 * delay + 1
    chain = np.eye(states, k=1)
    chain[[delay, -1]] = np.eye(states)[0]  # two chains that end in state 0
    transitions = np.stack([chain, chain], axis=1)
    transitions[0, 1] = np.eye(states)[delay + 1]
    rewards = np.zeros((2, states, 2))
    rewards[0, delay], rewards[0, -1], rewards[1, 0, 1] = 1.0, -1.0, 1.0
    return TabularMDP(0.9 * transitions + 0.1 * np.eye(states)[:, None], rewards)


@pytest.mark.parametrize("weights", ["paper", "usual"])
def test_the_plain_path_has_the_exact_expectation_too_and_forgets_nothing(weights: str) -> None:
    mdp, settings = (
        delayed_rewards(),
        GPOMDP(weights=weights, steps=12, trace_decay=0.8, average_rate=0.3, bias_correction=False),
    )
    policy, runs = SoftmaxTable(9, 2, np.random.default_rng(2).random(18)), 500
    plain = settings.with_driver(PythonDriver(TabularEnv(mdp), policy, streams(runs), settings.steps))
    estimate = plain.episode(np.tile(policy.parameters, (runs, 1)))
    value, gradient = expected_estimate(mdp, policy, settings)
    assert_mean(estimate.values, value, 6)
    assert_mean(estimate.gradients, gradient, 6)
    for decay in (0.75, 0.85):  # so many runs tell β = 0.8 from both
        other = expected_estimate(mdp, policy, replace(settings, trace_decay=decay))[1]
        with pytest.raises(AssertionError, match="standard errors off"):
            assert_mean(estimate.gradients, other, 6)


# --- the limit of long episodes ----------------------------------------------------------------------------------


@pytest.mark.parametrize("weights", ["paper", "usual"])
@pytest.mark.parametrize("decay", [0.5, 0.99])
@pytest.mark.parametrize("case", ["three-state", *CASES])
def test_long_episodes_tend_to_the_linear_solve_at_beta(case: str, decay: float, weights: str) -> None:
    """Within six standard errors over 40 runs of 20000 steps, plus a transient below 2/(T(1 − β))·max |r|."""
    mdp = ThreeStateMDP() if case == "three-state" else random_mdp(np.random.default_rng(1), *CASES[case])
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
