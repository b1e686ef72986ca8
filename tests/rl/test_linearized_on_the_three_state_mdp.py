"""`linearized` where rows and slacks sum to 0: whether its constraints can be met is decided by κ against αₑ alone."""

import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep, Linearization
from envs import ThreeStateMDP
from rl import SoftmaxTable

THRESHOLDS = np.zeros(3)
RATE = 0.3


def linearization(seed):
    """Exact values and gradients of a random policy, from nearly uniform ones to nearly deterministic ones."""
    rng, mdp = np.random.default_rng(seed), ThreeStateMDP()
    policy = SoftmaxTable(3, 3, rng.standard_normal(9) * 10.0 ** rng.uniform(-2, 0.5)).probabilities()
    return Linearization(mdp.average_rewards(policy), mdp.policy_gradients(policy).reshape(4, 9))


@pytest.mark.parametrize("kappa", [RATE, 1.0])
def test_with_as_much_to_lose_as_to_win_it_is_never_infeasible(kappa):
    """With κ = αₑ the constraints have no interior: they are met with equality, and rounding is no violation."""
    step = ConstrainedStep(formulation="linearized", slack_fraction=kappa, restoration_rate=RATE, step_size=0.5)
    for seed in range(20):
        each = linearization(seed)
        slack, result = each.values[1:], step(each, THRESHOLDS)
        assert abs(slack.sum()) <= 1e-15
        assert result.counts["infeasible"] == result.counts["fallback"] == 0
        left = np.where(slack < 0.0, 1.0 - RATE, 1.0 - kappa) * slack
        assert (result.predicted_slack >= left - 1e-12).all()
