"""Laws of stationary distributions and of the test for one recurrent class."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envs.markov_chain import recurrent_states, stationary_distribution


def random_chain(seed, states, concentration):
    return np.random.default_rng(seed).dirichlet(np.full(states, concentration), size=states)


@settings(max_examples=40)
@given(st.integers(0, 2**32), st.integers(1, 12), st.sampled_from([0.3, 1.0, 10.0]))
def test_a_stationary_distribution_is_unmoved_by_the_chain(seed, states, concentration):
    P = random_chain(seed, states, concentration)
    d = stationary_distribution(P)
    assert (d >= 0).all()
    assert d.sum() == pytest.approx(1, abs=1e-14)
    np.testing.assert_allclose(d @ P, d, atol=1e-14)


def test_two_states_follow_the_closed_form_even_where_they_hardly_mix():
    for leave, come_back in [(0.3, 0.4), (1e-300, 2e-300), (1e-12, 0.5), (1.0, 1.0), (5e-324, 5e-324)]:
        P = np.array([[1 - leave, leave], [come_back, 1 - come_back]])
        share = leave / come_back / (1 + leave / come_back)
        np.testing.assert_allclose(stationary_distribution(P), [1 - share, share], rtol=1e-14)


def test_transient_states_get_exactly_nothing():
    P = np.array([[0.5, 0.5, 0, 0], [0, 0, 0.3, 0.7], [0, 0, 0, 1.0], [0, 0, 1.0, 0]])
    assert recurrent_states(P).tolist() == [False, False, True, True]
    assert stationary_distribution(P).tolist() == [0, 0, 0.5, 0.5]


def test_a_stack_of_chains_is_answered_chain_by_chain():
    stack = np.stack([random_chain(seed, 4, 1.0) for seed in range(6)]).reshape(2, 3, 4, 4)
    stack[0, 1] = np.array([[0, 1.0, 0, 0], [0, 0, 0.5, 0.5], [0, 0, 0, 1], [0, 0, 1, 0]])
    answers = stationary_distribution(stack)
    for place in np.ndindex(2, 3):
        assert answers[place].tolist() == stationary_distribution(stack[place]).tolist()


@pytest.mark.parametrize(
    ("chain", "classes"),
    [
        (np.array([[0.2, 0.4, 0.4], [0, 1, 0], [0, 0, 1]]), "2: states [1] and [2]"),
        (np.eye(5), "5: states [0] and [1] and [2] …"),
    ],
)
def test_a_chain_with_several_recurrent_classes_is_refused_with_the_classes(chain, classes):
    with pytest.raises(ValueError, match="one recurrent class") as refusal:
        stationary_distribution(chain)
    assert str(refusal.value).endswith(f"found {classes}")


def test_a_chain_that_falls_apart_in_float64_is_refused_rather_than_answered_with_nan():
    # State 1 reaches state 0 only through state 2, with probability 1e-400.
    chain = np.array([[0, 1, 0], [0, 1, 1e-200], [1e-200, 0.5, 0.5]])
    with pytest.raises(ValueError, match="should multiply without underflow"):
        stationary_distribution(chain)
