"""Konda's actor-critic: its critic is TD(β)'s fixed point, its limit the exact gradient."""

from typing import Any

import numpy as np
import pytest

from envs import TabularMDP, ThreeStateMDP, random_mdp
from rl import KondaActorCritic, SoftmaxTable

from .stand_ins import streams

MDPS = {"three-state": ThreeStateMDP(), "five states": random_mdp(np.random.default_rng(11), 5, 3, 3)}


def table_of(mdp: TabularMDP, seed: int = 1) -> SoftmaxTable:
    return SoftmaxTable(mdp.states, mdp.actions, np.random.default_rng(seed).random(mdp.states * mdp.actions))


def fixed_point(mdp: TabularMDP, table: SoftmaxTable, decay: float) -> tuple[Any, Any]:
    """w of E[z (rⁱ − ρⁱ + wᵀ(ψ_{t+1} − ψ_t))] = 0 and E[ψψᵀ]w, (1 + m, n), with E[z_{t+1} f(q_t)] = ΨᵀD(I − βP)⁻¹f.

    Pairs q = (s, a) form a chain P with stationary distribution D.
    """
    pi, pairs = table.probabilities(), [(s, a) for s in range(mdp.states) for a in range(mdp.actions)]
    psi = np.array([table.score(s, a) for s, a in pairs])
    P = np.einsum("saj,jb->sajb", mdp.transitions, pi).reshape(len(pairs), len(pairs))
    D = np.diag((mdp.stationary_distribution(pi)[:, None] * pi).reshape(-1))
    surprise = (mdp.rewards - mdp.average_rewards(pi)[:, None, None]).reshape(mdp.reward_channels, -1).T
    weighted = psi.T @ D @ np.linalg.inv(np.eye(len(pairs)) - decay * P)
    A, b = weighted @ (np.eye(len(pairs)) - P) @ psi, weighted @ surprise
    w = np.linalg.lstsq(A, b, rcond=1e-10)[0]  # scores sum to zero in a state: w from 0 stays in their span
    return w.T, (psi.T @ D @ psi @ w).T


def settled(mdp: TabularMDP, table: SoftmaxTable, decay: float, rate: float, steps: int) -> dict[str, np.ndarray]:
    """w, Δ and ρ of 40 runs in their second long episode, at α_w = α_r = rate."""
    settings = KondaActorCritic(trace_decay=decay, critic_rate=rate, average_rate=rate, steps=steps)
    estimation = settings.start(mdp, table, streams(40, seed=int(1e6 * rate)))
    for _ in range(2):
        estimate = estimation.episode(np.tile(table.parameters, (40, 1)))
    return {"w": estimation.critics, "Δ": estimate.gradients, "ρ": estimate.values}  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("case", "decay", "rate", "steps"),
    [
        ("three-state", 0.9, 0.01, 15_000),
        ("five states", 0.5, 0.02, 15_000),
        pytest.param("three-state", 0.99, 0.001, 150_000, marks=pytest.mark.slow),
    ],
)
def test_critics_and_gradients_settle_at_the_fixed_point(case: str, decay: float, rate: float, steps: int) -> None:
    """Within six standard errors of 40 runs.

    Constant rates shift the mean of w by O(rate), so 2·(mean at half the rate) − (mean at the rate) is compared.
    """
    mdp = MDPS[case]
    table = table_of(mdp)
    w, gradient = fixed_point(mdp, table, decay)
    coarse, fine = settled(mdp, table, decay, rate, steps), settled(mdp, table, decay, rate / 2, steps)
    limits = {"w": w, "Δ": gradient, "ρ": mdp.average_rewards(table.probabilities())}
    for name, limit in limits.items():
        mean = 2 * fine[name].mean(axis=0) - coarse[name].mean(axis=0)
        error = np.sqrt((4 * fine[name].var(axis=0, ddof=1) + coarse[name].var(axis=0, ddof=1)) / 40)
        assert (np.abs(mean - limit) <= 6 * error + 1e-12).all(), name
        assert name == "ρ" or 6 * error.max() < 0.35 * np.abs(limit).max(), "the test should be able to fail"


def test_at_the_papers_rates_the_mean_gradient_points_the_same_way_and_is_half_as_long() -> None:
    mdp = ThreeStateMDP()
    table = table_of(mdp)
    estimation = KondaActorCritic(steps=100).start(mdp, table, streams(400))
    gradients = [estimation.episode(np.tile(table.parameters, (400, 1))).gradients.mean(axis=0) for _ in range(90)]
    mean, limit = np.mean(gradients[30:], axis=0), fixed_point(mdp, table, 0.99)[1]
    lengths = np.linalg.norm(mean, axis=1), np.linalg.norm(limit, axis=1)
    assert ((mean * limit).sum(axis=1) / (lengths[0] * lengths[1]) > 0.99).all()
    assert (np.abs(lengths[0] / lengths[1] - 0.5) < 0.1).all()
