"""GPOMDP: compiled = plain = eq. 3–4; its mean is the exact expectation; its long-run limit is the linear solve's."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from envs import TabularEnv, TabularMDP, ThreeStateMDP, random_mdp, random_state
from rl import GPOMDP, SoftmaxTable
from rl.drivers import PythonDriver
from rl.streams import run_streams

CASES = {  # states, actions, channels: one lane group and two; a search by counting and by bisection
    "two states": (2, 2, 2),
    "five states": (5, 3, 3),
    "no constraint": (3, 2, 1),
    "six channels": (4, 3, 6),
    "twenty states": (20, 2, 4),
    "twenty actions": (2, 20, 4),
}


def mdp_of(case: str) -> TabularMDP:
    return random_mdp(np.random.default_rng(len(case)), *CASES[case])


@functools.cache
def episode_streams(runs: int) -> list[np.random.SeedSequence]:
    return [run_streams(0, run).episodes for run in range(runs)]


# --- the same definition, the same draws -------------------------------------------------------------------------


def words(stream: np.random.SeedSequence):
    """xoshiro256++ in plain integers, written from the published recurrence."""
    s0, s1, s2, s3 = (int(word) for word in random_state(stream))
    mask = 2**64 - 1

    def rotated(x: int, k: int) -> int:
        return ((x << k) | (x >> (64 - k))) & mask

    while True:
        yield (rotated((s0 + s3) & mask, 23) + s0) & mask
        t = (s1 << 17) & mask
        s2 ^= s0
        s3 ^= s1
        s1 ^= s2
        s0 ^= s3
        s2 ^= t
        s3 = rotated(s3, 45)


@pytest.mark.parametrize(("weights", "steps"), [("paper", 2), ("usual", 1), ("usual", 2)])
def test_the_shortest_episodes_by_hand(steps: int, weights: str) -> None:
    """r(x₀, u₀) does not enter with the paper's weights, where T = 1 makes no update and is refused."""
    mdp = TabularMDP(np.ones((1, 2, 1)), [[[1.0, 3.0]]])
    settings = GPOMDP(weights=weights, steps=steps, trace_decay=0.5, average_rate=0.1, bias_correction=False)
    theta = np.array([[0.3, -0.2]])
    policy = SoftmaxTable(1, 2, theta[0])
    estimate = settings.start(mdp, policy, episode_streams(1)).episode(theta)
    draws = words(episode_streams(1)[0])
    actions = [int((next(draws) >> 32) / 2**32 >= policy.probabilities()[0, 0]) for _ in range(steps)]
    r, psi = [1.0 + 2 * a for a in actions], [policy.score(0, a) for a in actions]
    if weights == "paper":
        expected = r[1] * (psi[0] + psi[1])
        average = 0.1 * r[1]
    else:
        expected = r[0] * psi[0] if steps == 1 else (r[0] * psi[0] + r[1] * (0.5 * psi[0] + psi[1])) / 2
        average = 0.1 * r[0] if steps == 1 else 0.09 * r[0] + 0.1 * r[1]
    np.testing.assert_allclose(estimate.gradients[0, 0], expected, atol=1e-15)
    np.testing.assert_allclose(estimate.values[0, 0], average, atol=1e-15)
    np.testing.assert_allclose(estimate.rewards[0, 0], sum(r))


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


@pytest.mark.parametrize("weights", ["paper", "usual"])
@pytest.mark.parametrize("case", ["three-state", "five states", "six channels"])
def test_the_mean_of_many_episodes_is_the_exact_expectation_within_six_standard_errors(case: str, weights: str) -> None:
    mdp = ThreeStateMDP() if case == "three-state" else mdp_of(case)
    settings = GPOMDP(weights=weights, bias_correction=False)
    policy = SoftmaxTable(mdp.states, mdp.actions, np.random.default_rng(1).random(mdp.states * mdp.actions))
    runs = 8000
    estimate = settings.start(mdp, policy, episode_streams(runs)).episode(np.tile(policy.parameters, (runs, 1)))
    value, gradient = expected_estimate(mdp, policy, settings)
    assert_mean(estimate.values, value, 6)
    assert_mean(estimate.gradients, gradient, 6)


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
    plain = settings.with_driver(PythonDriver(TabularEnv(mdp), policy, episode_streams(runs), settings.steps))
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
@pytest.mark.parametrize("case", ["three-state", "two states", "five states", "twenty states"])
def test_long_episodes_tend_to_the_linear_solve_at_beta(case: str, decay: float, weights: str) -> None:
    """Within six standard errors over 40 runs of 20000 steps, plus a transient below 2/(T(1 − β))·max |r|."""
    mdp = ThreeStateMDP() if case == "three-state" else mdp_of(case)
    settings = GPOMDP(weights=weights, steps=20_000, trace_decay=decay)
    policy, runs = SoftmaxTable(mdp.states, mdp.actions, np.random.default_rng(3).random(mdp.states * mdp.actions)), 40
    estimate = settings.start(mdp, policy, episode_streams(runs)).episode(np.tile(policy.parameters, (runs, 1)))
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


# --- the boundary ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("setting", "value"),
    [("trace_decay", 1.0), ("trace_decay", np.nan), ("average_rate", -0.1), ("weights", "unusual"), ("steps", 0)],
)
def test_settings_outside_their_range_are_refused(setting: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"{setting} should be"):
        GPOMDP(**{setting: value})  # type: ignore[arg-type]


def test_a_table_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="policy should have 3 states and 3 actions"):
        GPOMDP().start(ThreeStateMDP(), SoftmaxTable(3, 2), episode_streams(1))


def test_what_is_no_environment_is_refused() -> None:
    with pytest.raises(ValueError, match="environment should be a Gymnasium environment"):
        GPOMDP().start(object(), SoftmaxTable(3, 3), episode_streams(1))


def test_an_environment_with_scalar_rewards_is_refused() -> None:
    import gymnasium

    with pytest.raises(ValueError, match="environment should have a reward_space"):
        GPOMDP().start(gymnasium.make("CartPole-v1"), SoftmaxTable(3, 3), episode_streams(1))
