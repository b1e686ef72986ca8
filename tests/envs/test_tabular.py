"""Laws of average rewards and policy gradients on finite MDPs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envs import TabularMDP, random_mdp
from rl.policies import softmax


@st.composite
def cases(draw):
    """A random MDP, softmax parameters, and the generator that made them."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    states, actions, channels = draw(st.integers(1, 5)), draw(st.integers(1, 4)), draw(st.integers(1, 4))
    return random_mdp(rng, states, actions, channels), rng.standard_normal((states, actions)), rng


@settings(max_examples=25)
@given(cases())
def test_average_rewards_are_what_a_long_chain_collects(case):
    mdp, parameters, _ = case
    policy = softmax(parameters)
    d = mdp.stationary_distribution(policy)
    np.testing.assert_allclose(d @ mdp.chain(policy), d, atol=1e-14)
    far_ahead = np.linalg.matrix_power(mdp.chain(policy), 2**20)[mdp.start]
    expected = [(far_ahead[:, None] * policy * channel).sum() for channel in mdp.rewards]
    np.testing.assert_allclose(mdp.average_rewards(policy), expected, atol=1e-9)


@settings(max_examples=25)
@given(cases())
def test_policy_gradients_agree_with_central_differences(case):
    mdp, parameters, _ = case
    gradients = mdp.policy_gradients(softmax(parameters))
    h = 1e-5
    for state, action in np.ndindex(parameters.shape):
        nudge = np.zeros_like(parameters)
        nudge[state, action] = h
        ahead, behind = (mdp.average_rewards(softmax(parameters + sign * nudge)) for sign in (1, -1))
        np.testing.assert_allclose(gradients[:, state, action], (ahead - behind) / (2 * h), atol=1e-7)


def test_policy_gradients_hold_for_periodic_and_unichain_policies():
    # Around the cycle 0 → 1 → 2 → 0 whatever is done; only the rewards depend on the action.
    cycle = np.repeat(np.roll(np.eye(3), 1, axis=1)[:, None, :], 2, axis=1)
    mdp = TabularMDP(cycle, [[[1, 0], [0, 2], [3, 3]]])
    expected = [[[1 / 12, -1 / 12], [-1 / 6, 1 / 6], [0, 0]]]
    np.testing.assert_allclose(mdp.policy_gradients(np.full((3, 2), 0.5)), expected, atol=1e-15)
    # State 0 is left for ever: what is done there changes no average.
    leaving = TabularMDP([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[[9, -9], [1, 0]]])
    np.testing.assert_allclose(leaving.policy_gradients(np.full((2, 2), 0.5)), [[[0, 0], [0.25, -0.25]]], atol=1e-15)


def score_weighted_sums(mdp, policy, weights):
    """Σₖ cₖ E[ψ_t r_{t+k}] from the definition: walk the joint distribution of (x_t, u_t) and x_{t+k}."""
    d, P = mdp.stationary_distribution(policy), mdp.chain(policy)
    expected_reward = (policy * mdp.rewards).sum(axis=-1)
    total = np.zeros(mdp.rewards.shape)
    for x, u in np.ndindex(policy.shape):
        score = np.zeros(policy.shape)
        score[x] = -policy[x]
        score[x, u] += 1
        ahead, later = mdp.transitions[x, u], weights[0] * mdp.rewards[:, x, u]
        for weight in weights[1:]:
            later = later + weight * (expected_reward @ ahead)
            ahead = ahead @ P
        total += d[x] * policy[x, u] * later[:, None, None] * score
    return total


@pytest.mark.parametrize("trace_decay", [0.0, 0.9])
@pytest.mark.parametrize("convention", ["paper", "usual"])
def test_discounted_score_gradients_are_the_sum_over_delays(trace_decay, convention):
    powers = trace_decay ** np.arange(400)
    weights = np.append(1, powers) if convention == "paper" else powers
    rng = np.random.default_rng(3)
    for states, actions in [(1, 3), (3, 3), (4, 2)]:
        mdp, policy = random_mdp(rng, states, actions, 3), rng.dirichlet(np.ones(actions), size=states)
        answer = mdp.discounted_score_gradients(policy, trace_decay, convention)
        np.testing.assert_allclose(answer, score_weighted_sums(mdp, policy, weights), atol=1e-13)


def test_a_stack_of_policies_is_answered_policy_by_policy():
    rng = np.random.default_rng(5)
    mdp = random_mdp(rng, 3, 2, 4)
    stack = rng.dirichlet(np.ones(2), size=(2, 5, 3))
    averages, gradients = mdp.average_rewards(stack), mdp.discounted_score_gradients(stack, 0.9)
    assert averages.shape == (2, 5, 4)
    assert gradients.shape == (2, 5, 4, 3, 2)
    for place in np.ndindex(2, 5):
        np.testing.assert_allclose(averages[place], mdp.average_rewards(stack[place]), rtol=1e-13)
        one = mdp.discounted_score_gradients(stack[place], 0.9)
        np.testing.assert_allclose(gradients[place], one, atol=1e-14)


def test_a_policy_with_several_recurrent_classes_is_refused_everywhere():
    stay_or_swap = TabularMDP([[[1, 0], [0, 1]], [[0, 1], [1, 0]]], np.zeros((2, 2, 2)))
    stay = [[1, 0], [1, 0]]
    for question in ("stationary_distribution", "average_rewards", "policy_gradients"):
        with pytest.raises(ValueError, match=r"one recurrent class.*states \[0\] and \[1\]"):
            getattr(stay_or_swap, question)(stay)


GOOD = np.full((2, 2, 2), 0.5)


EVEN = np.full((2, 2), 0.5)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"transitions": np.full((2, 2, 3), 1 / 3)}, "transitions should have shape"),
        ({"transitions": GOOD * 1.1}, "transitions should sum to 1"),
        ({"transitions": np.full((2, 2, 2), [1.1, -0.1])}, "transitions should hold probabilities"),
        ({"transitions": GOOD * np.nan}, "transitions should have no NaN"),
        ({"rewards": np.zeros((1, 2, 3))}, "rewards should have shape"),
        ({"start": 2}, "start should be in 0 … 1"),
        ({"policy": np.full((2, 3), 1 / 3)}, "policy should have shape"),
        ({"policy": [[0.5, 0.4], [0.5, 0.5]]}, r"policy should sum to 1 .* found 0.9 at \[0\]"),
        ({"trace_decay": 1.1}, r"trace_decay should be a number in \[0, 1\]"),
        ({"convention": "baxter"}, "convention should be 'paper' or 'usual'"),
    ],
)
def test_an_impossible_mdp_and_a_question_that_makes_no_sense_are_refused(wrong, message):
    given = {"transitions": GOOD, "rewards": np.zeros((1, 2, 2)), "start": 0, "policy": EVEN}
    given |= {"trace_decay": 0.9, "convention": "usual"} | wrong
    mdp, question = list(given.values())[:3], list(given.values())[3:]
    with pytest.raises(ValueError, match=message):
        TabularMDP(*mdp).discounted_score_gradients(*question)


def test_an_mdp_keeps_its_own_read_only_arrays():
    transitions, rewards = GOOD.copy(), np.ones((1, 2, 2))
    mdp = TabularMDP(transitions, rewards)
    transitions[:], rewards[:] = 7, 7
    assert mdp.transitions.tolist() == GOOD.tolist()
    assert mdp.rewards.tolist() == np.ones((1, 2, 2)).tolist()
    with pytest.raises(ValueError, match="read-only"):
        mdp.transitions[0, 0, 0] = 1
