"""Whatever is handed to a public door of `rl` and `envs` is taken, or a ValueError says what should come."""

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep
from envs import GridWorld, TabularEnv, TabularMDP, ThreeStateMDP, TwoLinkArm, function_type, random_mdp, random_state
from rl import (
    CPGRL,
    GPOMDP,
    ConstraintSwitching,
    GradientWithRestoration,
    KondaActorCritic,
    LinearGaussian,
    LinearSoftmax,
    NormalizedGaussianNetwork,
    SoftmaxTable,
    WeightedSum,
    train,
    uniform_parameters,
)

STRANGE = [
    None, 1.0, "hello", {}, object(), True, float("nan"), -1, np.array([1.0, np.nan]), np.ones((2, 2)), 10**400,
]  # fmt: skip
MDP, STEP = ThreeStateMDP(), ConstrainedStep()


def ones(_: Any) -> Any:
    return np.ones(3)


def learn(
    environment: Any, policy: Any, estimator: Any, learner: Any, episodes: Any = 1, runs: Any = 1, seed: Any = 0,
    initial: Any = None, max_change: Any = np.inf,
) -> None:  # fmt: skip
    kept = {"episodes": episodes, "runs": runs, "seed": seed, "initial": initial, "max_change": max_change}
    list(train(environment, policy, estimator, learner, **kept))


DOORS: dict[Callable[..., Any], dict[str, Any]] = {
    GridWorld: {},
    TabularMDP: {"transitions": MDP.transitions, "rewards": MDP.rewards},
    random_mdp: {"rng": np.random.default_rng(0), "states": 2, "actions": 2, "channels": 2},
    ThreeStateMDP: {},
    TwoLinkArm: {},
    TabularEnv: {"mdp": MDP},
    function_type: {"signature": "float64(float64)"},
    random_state: {"seed": np.random.SeedSequence(0)},
    GPOMDP: {},
    KondaActorCritic: {},
    SoftmaxTable: {"states": 3, "actions": 3},
    LinearGaussian: {"features": ones, "size": 3, "dimensions": 2},
    LinearSoftmax: {"features": ones, "size": 3, "actions": 2},
    NormalizedGaussianNetwork: {"low": [0.0, 0.0], "high": [1.0, 1.0], "counts": (2, 2), "dimensions": 2},
    CPGRL: {"step": STEP, "thresholds": [0.0, 0.0, 0.0]},
    ConstraintSwitching: {"thresholds": [0.0, 0.0, 0.0]},
    GradientWithRestoration: {"step": STEP, "thresholds": [0.0, 0.0, 0.0]},
    WeightedSum: {"weights": [1.0, 1.0, 1.0, 1.0]},
    uniform_parameters: {"n": 3},
    learn: {
        "environment": MDP,
        "policy": SoftmaxTable(3, 3),
        "estimator": GPOMDP(),
        "learner": CPGRL(STEP, [0.0, 0.0, 0.0]),
    },
}


@pytest.mark.parametrize("door", DOORS, ids=lambda door: door.__name__)
def test_strange_arguments_are_taken_or_named(door: Callable[..., Any]) -> None:
    given, refused = DOORS[door], 0
    door(**given)
    for name in inspect.signature(door).parameters:
        for strange in STRANGE:
            if name == "episodes" and isinstance(strange, int) and strange > 1:
                continue  # as many as that would be trained
            told = None
            try:
                door(**{**given, name: strange})
            except ValueError as error:
                told = str(error)
            assert told is None or " should " in told, f"{name}={strange!r}: {told}"
            refused += told is not None
    assert refused >= len(STRANGE) // 2
