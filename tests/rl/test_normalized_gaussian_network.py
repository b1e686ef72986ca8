"""The normalised Gaussian network: its basis, its density, its score; compiled = plain."""

import numpy as np
import pytest

from envs import random_state
from rl import NormalizedGaussianNetwork
from rl.policies.normalized_gaussian_kernels import act, fill_features, grid_of, normal_pair

LOW, HIGH = [-1.0, 2.0], [1.0, 9.0]


def network(deviation: float = 1.0, width: float = 1.0) -> NormalizedGaussianNetwork:
    theta = np.random.default_rng(0).normal(size=80)
    return NormalizedGaussianNetwork(LOW, HIGH, (5, 8), 2, deviation=deviation, width=width, parameters=theta)


def by_definition(policy: NormalizedGaussianNetwork, state: np.ndarray) -> np.ndarray:
    """gⱼ/Σg over the list of all centres, none taken apart by axes."""
    axes = [np.linspace(*ends) for ends in zip(policy.low, policy.high, policy.counts, strict=True)]
    centres = np.array(np.meshgrid(*axes, indexing="ij")).reshape(len(axes), -1).T
    widths = policy.width * np.array([axis[1] - axis[0] for axis in axes])
    g = np.exp(-0.5 * (((state - centres) / widths) ** 2).sum(axis=1))
    return g / g.sum()


@pytest.mark.parametrize("width", [0.5, 3.0])
@pytest.mark.parametrize("counts", [(2,), (3, 2, 4)])
def test_features_are_gaussians_of_all_centres_over_their_sum(counts: tuple[int, ...], width: float) -> None:
    rng, axes = np.random.default_rng(1), len(counts)
    policy = NormalizedGaussianNetwork(-np.ones(axes), np.arange(1, axes + 1), counts, 1, width=width)
    for state in rng.uniform(-2, axes + 1, (50, axes)):
        np.testing.assert_allclose(policy.features(state), by_definition(policy, state), rtol=1e-11)


def test_one_weight_moves_the_mean_most_at_its_centre() -> None:
    policy = network()
    for a, b, c in [(0, 0, 0), (1, 0, 1), (0, 1, 0), (4, 7, 1), (2, 5, 0)]:
        theta = np.zeros(80)
        theta[2 * (8 * a + b) + c] = 1.0
        one = policy.with_parameters(theta)
        grid = [[one.mean([x, y])[c] for y in np.linspace(2, 9, 8)] for x in np.linspace(-1, 1, 5)]
        assert np.unravel_index(np.argmax(grid), (5, 8)) == (a, b)
        assert one.mean([0.0, 5.0])[1 - c] == 0


def test_grids_that_are_none_are_refused() -> None:
    for wrong, message in (
        ({"low": [0.0]}, r"low should have shape \(2,\)"),
        ({"low": [1.0, 2.0]}, "low < high"),
        ({"counts": (5, 1)}, "counts should be an integer ≥ 2; found 1"),
        ({"width": 0.01}, "width should be"),
    ):
        with pytest.raises(ValueError, match=message):
            NormalizedGaussianNetwork(**{"low": LOW, "high": HIGH, "counts": (5, 8), "dimensions": 2, **wrong})  # type: ignore[arg-type]


def compiled_features(policy: NormalizedGaussianNetwork, state: np.ndarray) -> np.ndarray:
    features = np.empty(policy.size)
    fill_features(np.array(state, dtype=float), *grid_of(policy), np.empty(max(policy.counts)), features)
    return features


@pytest.mark.parametrize("width", [0.1, 3.0])
@pytest.mark.parametrize("counts", [(3, 2, 4), (1500,)])
def test_compiled_features_are_the_plain_ones(counts: tuple[int, ...], width: float) -> None:
    rng, axes = np.random.default_rng(3), len(counts)
    policy = NormalizedGaussianNetwork(np.zeros(axes), np.array(counts) - 1.0, counts, 1, width=width)
    states = rng.uniform(-1.5, 1.5, (50, axes)) * policy.high
    for state in np.concatenate([states, 1e4 * states[:5]]):
        np.testing.assert_allclose(compiled_features(policy, state), policy.features(state), rtol=1e-9, atol=1e-14)


def test_a_state_that_is_no_number_gives_features_that_are_none() -> None:
    for state in ([np.nan, 5.0], [0.0, np.nan], [np.inf, np.nan]):
        assert np.isnan(compiled_features(network(), np.array(state))).any()


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_a_compiled_action_carries_its_own_score(dimensions: int) -> None:
    theta = np.random.default_rng(4).normal(size=40 * dimensions)
    policy = NormalizedGaussianNetwork(LOW, HIGH, (5, 8), dimensions, deviation=0.5, parameters=theta)
    words = random_state(np.random.SeedSequence(1))
    swapped = np.ascontiguousarray(theta.reshape(40, dimensions).T).ravel()
    score, action = np.empty(theta.size), np.empty(dimensions)
    for state in np.random.default_rng(5).uniform(LOW, HIGH, (20, 2)):
        draws = words.copy()
        act(swapped, state, 0.5, *grid_of(policy), words, np.empty(8), np.empty(40), action, score)
        noise = np.ravel([normal_pair(draws) for _ in range((dimensions + 1) // 2)])[:dimensions]
        np.testing.assert_array_equal(words, draws)
        np.testing.assert_allclose(action, policy.mean(state) + 0.5 * noise, rtol=1e-12)
        by_rows = score.reshape(dimensions, 40).T.ravel()
        np.testing.assert_allclose(by_rows, policy.score(state, action), atol=1e-12)


def test_compiled_normals_are_normal_and_pairs_independent() -> None:
    from scipy.stats import chi2, kstest  # takes a second: here, for one worker only

    words = random_state(np.random.SeedSequence(2))
    pairs = np.array([normal_pair(words) for _ in range(50_000)])
    assert kstest(pairs.ravel(), "norm").pvalue > 1e-6
    assert kstest((pairs**2).sum(axis=1), chi2(2).cdf).pvalue > 1e-6
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 6 / np.sqrt(50_000)
