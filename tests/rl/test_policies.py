"""Scores are the gradients of log π, and samples follow π."""

import numpy as np
import pytest

from rl import LinearGaussian, LinearSoftmax, NormalizedGaussianNetwork, SoftmaxTable


def features(observation: np.ndarray) -> np.ndarray:
    x, y = observation
    return np.array([1.0, x, y, x * y])


OBSERVATION = np.array([0.3, -1.2])
THETA = np.random.default_rng(0).normal(size=12)
TABLE = SoftmaxTable(4, 3, THETA)
SOFTMAX = LinearSoftmax(features, 4, 3, THETA)
GAUSSIAN = LinearGaussian(features, 4, 3, deviation=0.7, parameters=THETA)
NETWORK = NormalizedGaussianNetwork([0.0, 0.0], [1.0, 1.0], (2, 2), 3, deviation=0.7, parameters=THETA)


def log_probability(policy, observation, action) -> float:
    """log π from the definition, not through the policy's own methods."""
    if policy.__class__ in (LinearGaussian, NormalizedGaussianNetwork):
        mean, sigma = policy.features(observation) @ policy.parameters.reshape(4, 3), policy.deviation
        return float(-0.5 * (((action - mean) / sigma) ** 2 + np.log(2 * np.pi * sigma**2)).sum())
    rows = policy.parameters.reshape(4, 3)
    preferences = rows[observation] if isinstance(policy, SoftmaxTable) else features(observation) @ rows
    return float(preferences[action] - np.log(np.exp(preferences).sum()))


CHOICES = [(TABLE, s, a) for s in range(4) for a in range(3)]
CHOICES += [(SOFTMAX, OBSERVATION, a) for a in range(3)]
CHOICES += [(GAUSSIAN, OBSERVATION, np.array([0.1, 2.0, -0.4])), (GAUSSIAN, -OBSERVATION, np.zeros(3))]
CHOICES += [(NETWORK, OBSERVATION, np.array([0.1, 2.0, -0.4])), (NETWORK, -OBSERVATION, np.zeros(3))]


@pytest.mark.parametrize("choice", range(len(CHOICES)))
def test_the_score_is_the_gradient_of_the_log_probability(choice: int) -> None:
    policy, observation, action = CHOICES[choice]
    step = 1e-5
    above, below = (
        [log_probability(policy.with_parameters(THETA + h * e), observation, action) for e in np.eye(12)]
        for h in (step, -step)
    )
    np.testing.assert_allclose(policy.score(observation, action), np.subtract(above, below) / (2 * step), atol=1e-8)


def test_samples_follow_the_distribution() -> None:
    rng, count = np.random.default_rng(5), 20_000
    for policy, observation, pi in (
        (TABLE, 1, TABLE.probabilities()[1]),
        (SOFTMAX, OBSERVATION, SOFTMAX.probabilities(OBSERVATION)),
    ):
        shares = np.bincount([policy.sample(observation, rng) for _ in range(count)], minlength=3) / count
        assert np.abs(shares - pi).max() < 6 * 0.5 / np.sqrt(count)
    noise = np.array([GAUSSIAN.sample(OBSERVATION, rng) for _ in range(count)]) - GAUSSIAN.mean(OBSERVATION)
    assert np.abs(noise.mean(axis=0)).max() < 6 * 0.7 / np.sqrt(count)
    np.testing.assert_allclose(np.cov(noise.T), 0.49 * np.eye(3), atol=0.03)


def test_many_parameters_give_as_many_tables() -> None:
    many = np.random.default_rng(6).normal(size=(5, 2, 12))
    tables = TABLE.probabilities(many)
    assert tables.shape == (5, 2, 4, 3)
    np.testing.assert_array_equal(tables[3, 1], TABLE.with_parameters(many[3, 1]).probabilities())


def test_huge_parameters_neither_overflow_nor_divide_by_zero() -> None:
    table = SoftmaxTable(2, 2, [8e307, -8e307, 0.0, 800.0])
    np.testing.assert_array_equal(table.probabilities(), [[1, 0], [0, 1]])
    assert np.isfinite(table.score(0, 1)).all()


@pytest.mark.parametrize("policy", [TABLE, SOFTMAX, GAUSSIAN, NETWORK])
def test_policies_are_immutable_and_keep_a_copy(policy) -> None:
    theta = np.arange(12.0)
    other = policy.with_parameters(theta)
    theta[0] = 99
    assert other.parameters[0] == 0
    np.testing.assert_array_equal(policy.parameters, THETA)
    with pytest.raises(ValueError, match="read-only"):
        other.parameters[0] = 1
    with pytest.raises(AttributeError):
        policy.parameters = theta


@pytest.mark.parametrize(
    "parameters",
    [
        None, ["1"] * 12, np.ones(12) * 1j, np.ma.masked_all(12), [[0.0], [0.0, 1.0]], np.zeros((4, 3)),
        np.full(12, np.nan),
    ],
)  # fmt: skip
def test_what_is_no_theta_is_refused(parameters) -> None:
    """None was taken for zeros, strings for the numbers that they spell, masked entries for what the mask hides."""
    with pytest.raises(ValueError, match="parameters should"):
        TABLE.with_parameters(parameters)


@pytest.mark.parametrize("found", [["1", "2"], [None, 1.0], [1j, 2.0]])
def test_features_that_are_no_numbers_are_refused(found) -> None:
    for policy in (LinearSoftmax(lambda _: found, 2, 2), LinearGaussian(lambda _: found, 2, 2)):
        with pytest.raises(ValueError, match="what the policy's features return should be an array of real numbers"):
            policy.sample(0, np.random.default_rng(0))
    for found in ([1, True], np.array([False, True])):  # lists, integers and truth values are numbers
        for policy in (LinearSoftmax(lambda _, f=found: f, 2, 2), LinearGaussian(lambda _, f=found: f, 2, 2)):
            assert policy.score(0, 0).shape == (4,)
