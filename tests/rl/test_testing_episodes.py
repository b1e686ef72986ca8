"""`check_episodic_estimator`: exact gradients are exact, right estimators pass, those of other averages do not."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from envs import random_mdp
from rl import GPOMDP, KondaActorCritic, SoftmaxTable
from rl.testing import ContractBroken, EpisodicEnv, EpisodicMDP, check_constrained_env, check_episodic_estimator

ONE_OF_EACH = ("step", "episode", "episode")
USUAL = GPOMDP(weights="usual", average=ONE_OF_EACH, trace_decay=0.999)
# Rates at which its critics have settled after the warm-up and their bias, which is proportional to them, is small.
KONDA = KondaActorCritic(average=ONE_OF_EACH, trace_decay=0.999, average_rate=0.005, critic_rate=0.05)
ONCE: dict[str, Any] = {"average": ONE_OF_EACH, "mdps": 1}


def episodic(seed: int = 0) -> EpisodicMDP:
    rng = np.random.default_rng(seed)
    mdp = random_mdp(rng, 3, 2, 3)
    return EpisodicMDP(mdp.transitions, rng.uniform(0.05, 0.6, (3, 2)), mdp.rewards, start=1)


def test_averages_are_those_of_the_absorbing_chain() -> None:
    """Visits before the end are start·(I − P)⁻¹, without the restart; gradients by central differences."""
    mdp, theta = episodic(), np.random.default_rng(1).normal(size=6)

    def expected(theta: np.ndarray, first_step: bool) -> tuple[np.ndarray, np.ndarray]:
        table = SoftmaxTable(3, 2).probabilities(theta)
        P = np.einsum("sa,saj->sj", table, (1 - mdp.quits)[:, :, None] * mdp.transitions)
        visits = np.linalg.solve((np.eye(3) - P).T, np.eye(3)[mdp.start])
        shares = visits[:, None] * table
        sums = (mdp.rewards * shares).sum(axis=(1, 2))
        first = (mdp.rewards[:, mdp.start] * table[mdp.start]).sum(axis=1)
        ratio = sums / visits.sum() if first_step else (sums - first) / (visits.sum() - 1)
        return sums, ratio

    for first_step in (True, False):
        for kind, by_episode in enumerate((True, False)):
            table = SoftmaxTable(3, 2).probabilities(theta)
            values, gradients = mdp.averages(table, np.full(3, by_episode), first_step=first_step)
            np.testing.assert_allclose(values, expected(theta, first_step)[kind], rtol=1e-12)
            for index, e in enumerate(1e-5 * np.eye(6)):
                up, down = (expected(theta + h, first_step)[kind] for h in (e, -e))
                np.testing.assert_allclose(gradients[:, index], (up - down) / 2e-5, atol=1e-8)


def test_the_environment_keeps_what_training_relies_on() -> None:
    mdp = episodic()
    check_constrained_env(EpisodicEnv(mdp), expected_reward=lambda s, a, _: mdp.rewards[:, s, a])


@pytest.mark.parametrize(
    ("estimator", "options"),
    [
        (USUAL, {}),
        (GPOMDP(average="episode", trace_decay=0.999), {"average": "episode"}),
        (KONDA, {"warm_up": 100, "bias": 0.15}),
        pytest.param(
            GPOMDP(trace_decay=0.999),
            {"average": "step", "first_step": False, "episodes": 1500},
            marks=pytest.mark.slow,
        ),
    ],
    ids=["usual", "paper, per episode", "Konda", "paper, per step"],
)  # fmt: skip
def test_a_right_estimator_passes(estimator: Any, options: dict[str, Any]) -> None:
    check_episodic_estimator(estimator, **{**ONCE, **options})


SUMS: dict[str, Any] = {"average": "episode", "episodes": 80}


@dataclass(frozen=True)
class WithoutLength:
    """GPOMDP that leaves ρ∇E[T] out."""

    inner: GPOMDP

    def start(self, *arguments: Any) -> Any:
        estimation: Any = self.inner.start(*arguments)
        convert = estimation.reported.convert
        estimation.reported.convert = lambda means, updates, entered, _: convert(means, updates, entered)
        return estimation


@pytest.mark.parametrize(
    ("estimator", "options", "told"),
    [
        (GPOMDP(weights="usual", average="episode", gradient="episode mean"), SUMS, "Δ of channel 0"),
        (WithoutLength(GPOMDP(weights="usual")), {"average": "step"}, r"Δ of channel \d should be ∇g"),
        (GPOMDP(weights="usual", average="episode"), {"average": "step", "episodes": 40}, "exact average per step"),
    ],
    ids=["own mean", "no ρ-term", "another average"],
)  # fmt: skip
def test_an_estimator_of_another_gradient_is_told_what_should_be(
    estimator: Any, options: dict[str, Any], told: str
) -> None:
    with pytest.raises(ContractBroken, match=told):
        check_episodic_estimator(estimator, mdps=1, bias=0.05, z=4, **options)
