"""CPGRL with Konda's actor-critic on the two-link arm: how the update as printed fails, and what keeps it (§4)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep
from envs import TwoLinkArm
from rl import CPGRL, DivergenceError, KondaActorCritic, NormalizedGaussianNetwork, train

ARM = TwoLinkArm()
SAFEGUARDS = {"drop": "never", "ridge": 1e-4, "max_restoration": 0.1}  # ours: docs/reproduction.md §3
PRINTED = {"solver": "rosen", "drop": "never"}


def records(thresholds: Sequence[float], step: dict[str, Any], *, deviation: float = 1.0, **settings: Any) -> Any:
    policy = NormalizedGaussianNetwork(*ARM.stops, (5, 8), 2, deviation=deviation)
    estimator = KondaActorCritic(gradient="episode mean", bias_correction=False)
    return train(ARM, policy, estimator, CPGRL(ConstrainedStep(**step), thresholds), **settings)


def test_the_printed_update_throws_theta_away_and_training_says_so() -> None:
    """J⁺g is long where the gradients of short episodes are tiny; measured: 98 % of the updates exceed 1 in (c)."""
    message = r"θ\[\d+\] in run \d should move by at most max_change = 10 .* Lower the rates, or set"
    with pytest.raises(DivergenceError, match=message):
        list(records((0.0, 0.5), PRINTED, episodes=100, runs=8, max_change=10))
    changes = [np.linalg.norm(r.update.change, axis=1) for r in records((0.0, 0.5), PRINTED, episodes=60, runs=4)]
    assert np.mean(np.array(changes) > 1) > 0.5


def test_with_the_safeguards_no_update_is_long() -> None:
    """‖αₑd‖ ≤ 0.1, and ‖α₁PΔ¹‖ is far below."""
    for record in records((0.0, 0.5), SAFEGUARDS, episodes=100, runs=4, max_change=0.2):
        assert np.linalg.norm(record.update.change, axis=1).max() < 0.11


def test_critics_that_overflow_are_named() -> None:
    """ψ grows as 1/σ: the rates fit σ of the order of 1 in the unit of u, and the critics of a smaller one explode."""
    with pytest.raises(DivergenceError, match=r"the estimate of channel 0 in run 0, episode \d, should be finite"):
        list(records((0.0, 0.0), SAFEGUARDS, deviation=0.1, episodes=100, runs=3))
