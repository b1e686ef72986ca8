"""What an estimate holds is never written again: each of its arrays is its own."""

import itertools

import numpy as np
import pytest

from envs import ThreeStateMDP, TwoLinkArm
from rl import GPOMDP, ExactGradient, KondaActorCritic, NormalizedGaussianNetwork, SoftmaxTable
from rl.streams import run_streams

PAIRS = {
    "table": (ThreeStateMDP(), SoftmaxTable(3, 3)),
    "arm": (TwoLinkArm(), NormalizedGaussianNetwork(*TwoLinkArm().stops, (3, 3), 2)),
}


@pytest.mark.parametrize(
    ("estimator", "pair"),
    [
        (GPOMDP(steps=3), "table"),
        (GPOMDP(steps=3), "arm"),
        (KondaActorCritic(steps=3), "table"),
        (KondaActorCritic(steps=3), "arm"),
        (ExactGradient(), "table"),
    ],
)
def test_no_two_arrays_of_two_estimates_share_memory(estimator, pair):
    environment, policy = PAIRS[pair]
    estimation = estimator.start(environment, policy, [run_streams(0, 0).episodes])
    estimates = [estimation.episode(np.array([policy.parameters])) for _ in range(2)]
    arrays = [
        getattr(each, name) for each in estimates for name in ("values", "gradients", "steps", "rewards", "events")
    ]
    assert not any(np.shares_memory(one, other) for one, other in itertools.combinations(arrays, 2))
