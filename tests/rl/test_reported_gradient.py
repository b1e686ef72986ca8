"""Δ is the gradient of the ρ that is reported, also where episodes differ in length (`ReportedGradient`)."""

from typing import Any

import numpy as np
import pytest

from rl import GPOMDP, KondaActorCritic, SoftmaxTable
from rl.estimators.reported_gradient import ReportedGradient
from rl.estimators.stored_average import MeanWeight

from .stand_ins import streams, two_or_eight


def test_per_step_gpomdp_climbs_the_ratio_that_it_reports() -> None:
    """As printed the first step is left out: ∇ (1 + p)/(1 + 6p) = −5 p(1 − p)/(1 + 6p)² at p = ½; 0 for −1 a step."""
    estimation = GPOMDP(trace_decay=0.999).start(two_or_eight(), SoftmaxTable(2, 2), streams(4))
    drawn = np.array([estimation.episode(np.zeros((4, 4))).gradients[:, :, 1] for _ in range(400)])
    found = drawn[100:].reshape(-1, 2)  # two lengths have been seen: −1 has gradient 0 exactly
    error = found.std(axis=0, ddof=1) / np.sqrt(len(found))
    np.testing.assert_array_less(np.abs(found.mean(axis=0) - [-0.25 * 5 / 16, 0.0]), 5 * error + 0.002)
    assert error.max() < 0.002


@pytest.mark.parametrize("estimator", [GPOMDP, KondaActorCritic])
def test_channels_of_both_kinds_stand_side_by_side(estimator: Any) -> None:
    shared = {"trace_decay": 0.999, "average_rate": 0.3, "bias_correction": False}
    each = [
        estimator(average=average, **shared).start(two_or_eight(), SoftmaxTable(2, 2), streams(5))  # the same draws
        for average in (("step", "episode"), "step", "episode")
    ]
    sums = np.zeros((5, 2))
    for _ in range(6):
        both, *alone = (estimation.episode(np.zeros((5, 4))) for estimation in each)
        for channel in (0, 1):
            np.testing.assert_array_equal(both.gradients[:, channel], alone[channel].gradients[:, channel])
            np.testing.assert_array_equal(both.values[:, channel], alone[channel].values[:, channel])
        sums += 0.3 * (both.rewards - sums)
        np.testing.assert_allclose(both.values[:, 1], sums[:, 1])


def converted(lengths: list[int], rate: float = 0.1, kinds: tuple[bool, ...] = (False,)) -> list[np.ndarray]:
    """Δ of one run whose mean is 1, whose rewards are 2 a step and whose spans are the episode's number."""
    reported = ReportedGradient(np.array(kinds), rate, 1, as_printed=False)
    ones = np.ones((1, len(kinds), 1))
    return [
        reported.convert(ones, np.array([n]), np.full((1, len(kinds)), 2.0 * n), np.full((1, 1), 1.0 + k))[0, :, 0]
        for k, n in enumerate(lengths)
    ]


def test_the_first_episodes_by_hand() -> None:
    """N̄ = 4, 4, then 4 + (6 − 4)/(1 + 0.9 + 0.81); ρ = 2; a mean of 1 over N updates is a sum of N."""
    third = 4 + (6 - 4) / (1 + 0.9 + 0.81)
    expected = [1, 1, 6 / 4 - 2 * 3 / 4, 3 / third - 2 * 4 / third]
    np.testing.assert_allclose(np.ravel(converted([4, 4, 6, 3])), expected)


def test_one_long_episode_after_a_short_one_counts_as_in_their_mean() -> None:
    _, second = converted([2, 1000], rate=0.0)
    np.testing.assert_allclose(second, 1000 / 500 - 2 * 2 / 500)


def test_episodes_without_an_update_move_nothing_and_count_in_the_mean() -> None:
    """N = 0, 0, 3: N̄ is 0 before the third, which then counts for a third of its length."""
    np.testing.assert_allclose(np.ravel(converted([0, 0, 3], rate=0.0)), [0, 0, 3])
    np.testing.assert_allclose(np.ravel(converted([0, 3], kinds=(True,))), [1, 3])


def test_means_of_equal_numbers_are_that_number_whatever_the_rate() -> None:
    for rate in (0.0, 1e-300, 1e-9, 0.02, 0.3, 1.0):
        weight, mean = MeanWeight(rate), 0.0
        for _ in range(50):
            mean += weight.next() * (0.1 - mean)
            assert mean == 0.1


def test_what_is_no_gradient_is_refused() -> None:
    for estimator in (GPOMDP, KondaActorCritic):
        with pytest.raises(ValueError, match="gradient should be one of reported, episode mean; found 'mean'"):
            estimator(gradient="mean")
