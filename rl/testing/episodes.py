"""`check_episodic_estimator`: estimates against exact gradients where episodes end at different lengths."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cpgrl_opt.arrays import Bool, Float
from envs import TabularEnv, TabularMDP

from ..policies import SoftmaxTable
from .contract import allow_limits
from .estimators import check_averages, check_gradients, mean_estimates

_STATES, _ACTIONS = 3, 2
_QUITS = ((0.6, 0.9), (0.1, 0.3))  # between which an action's chance to end the episode is drawn
_OFFSETS = (1.0, -1.0, 0.5)  # of the channels' rewards: without them ρ∇E[T] would be a trifle
_CANDIDATES = 6


@dataclass(frozen=True, eq=False)
class EpisodicMDP:
    """A finite MDP whose episodes end: (s, a) is the last step with probability quits(s, a), and yields r(s, a) too.

    Restarted at `start` where an episode ends, it is a `TabularMDP` that goes on for ever, `restarted`, with one more
    channel e = quits(s, a). There an episode is a renewal, so that averages per step are

        g_e = 1/E[T],   gⁱ = E[Σ_t rⁱ_t] / E[T]        ⇒    E[Σ_t rⁱ_t] = gⁱ/g_e

    which with their exact gradients gives those of every average that an estimator may report.

    Parameters
    ----------
    transitions
        (S, A, S), where the episode goes on.
    quits
        (S, A), probabilities.
    rewards
        (1 + m, S, A).
    start
        First state of an episode.
    """

    transitions: Float[np.ndarray, "S A S"]
    quits: Float[np.ndarray, "S A"]
    rewards: Float[np.ndarray, "channels S A"]
    start: int = 0

    @property
    def restarted(self) -> TabularMDP:
        """The MDP that begins anew where an episode ends; its last channel counts the ends."""
        goes_on = (1 - self.quits)[:, :, None] * self.transitions
        goes_on[:, :, self.start] += self.quits
        return TabularMDP(goes_on, np.concatenate([self.rewards, self.quits[None]]), self.start)

    def averages(
        self, table: Float[np.ndarray, "S A"], by_episode: Bool[np.ndarray, "channels"], *, first_step: bool = True
    ) -> tuple[Float[np.ndarray, "channels"], Float[np.ndarray, "channels n"]]:
        """ρⁱ and ∇ρⁱ with respect to the softmax parameters of π: E[Σ rⁱ] where by_episode, else E[Σ rⁱ]/E[T].

        Parameters
        ----------
        table
            π(a|s), (S, A).
        by_episode
            (1 + m,).
        first_step
            Whether the first step counts in E[Σ rⁱ]/E[T]; if not, it is E[Σ_{t≥1} rⁱ]/E[T − 1].

        Returns
        -------
        tuple of arrays
            (1 + m,) and (1 + m, S·A).
        """
        restarted = self.restarted
        g, slopes = restarted.average_rewards(table), restarted.policy_gradients(table)
        # E[Σ r] of each channel, and of a reward of 1: E[T].
        sums = np.append(g[:-1], 1.0) / g[-1]
        sum_slopes = np.append(slopes[:-1], np.zeros_like(slopes[:1]), axis=0)
        gradients = (sum_slopes - sums[:, None, None] * slopes[-1]) / g[-1]
        kept, kept_slopes = sums.copy(), gradients.copy()
        if not first_step:
            first = np.append(self.rewards[:, self.start], np.ones((1, table.shape[1])), axis=0)
            expected = first @ table[self.start]
            kept -= expected
            kept_slopes[:, self.start] -= table[self.start] * (first - expected[:, None])
        ratios = kept[:-1] / kept[-1]
        ratio_slopes = (kept_slopes[:-1] - ratios[:, None, None] * kept_slopes[-1]) / kept[-1]
        values = np.where(by_episode, sums[:-1], ratios)
        return values, np.where(by_episode[:, None, None], gradients[:-1], ratio_slopes).reshape(len(values), -1)


class EpisodicEnv(TabularEnv):
    """An `EpisodicMDP` as a Gymnasium environment: `terminated` after a last step; MO-Gymnasium's `reward_space`."""

    def __init__(self, mdp: EpisodicMDP) -> None:
        super().__init__(TabularMDP(mdp.transitions, mdp.rewards, mdp.start))
        self.quits = mdp.quits

    def step(self, action: np.int64 | int) -> tuple[np.int64, np.ndarray, bool, bool, dict[str, Any]]:
        """r(s, a), the next state, and whether the episode is over."""
        ends = bool(self.np_random.random() < self.quits[self._current_state(), action])
        following, reward, _, _, info = super().step(action)
        return following, reward, ends, False, info


@allow_limits
def check_episodic_estimator(
    estimator: Any,
    *,
    average: str | Sequence[str] = "step",
    first_step: bool = True,
    mdps: int = 2,
    runs: int = 10,
    episodes: int = 250,
    warm_up: int = 20,
    bias: float = 0.1,
    up_to_scale: bool = False,
    seed: int = 0,
    z: float = 5.0,
) -> None:
    """ContractBroken where an estimator does not climb the average that it reports, episodes differing in length.

    On `mdps` random MDPs of 3 states, 2 actions and 3 channels, where one action mostly ends the episode and the other
    mostly does not, as Gymnasium environments, with a random `SoftmaxTable` each (a fixed θ):
    ‖mean Δⁱ − ∇ρⁱ‖ ≤ bias·‖∇ρⁱ‖ + z·SE and |mean ρⁱ − its exact value| ≤ bias·(sd of rⁱ, times E[T] for a sum) + z·SE
    for every channel i, over `episodes` episodes of `runs` runs after `warm_up` episodes.

    Parameters
    ----------
    average
        What the estimator reports, for all channels or for each: "step", E[Σ r]/E[T], or "episode", E[Σ r].
    first_step
        Whether the first step counts in the former; it does not in GPOMDP's with the weights "paper".
    bias, up_to_scale
        As in `check_gradient_estimator`, as is what happens where too little was sampled to tell.
    time_limit, memory_limit
        Where either is given, as seconds and bytes, the check runs in a process of its own, and what hangs or crashes
        there is ContractBroken too.

    Notes
    -----
    Not seen: errors below the bias allowed; a ρ-term that is wrong by less.
    """
    for number in range(mdps):
        rng = np.random.default_rng([seed, number])
        policy, theta = SoftmaxTable(_STATES, _ACTIONS), rng.normal(0.0, 0.5, _STATES * _ACTIONS)
        table = policy.probabilities(theta)
        mdp = _draw_episodic_mdp(rng, table)
        kinds = [average] * len(mdp.rewards) if isinstance(average, str) else list(average)
        by_episode = np.array([kind == "episode" for kind in kinds])
        exact, slopes = mdp.averages(table, by_episode, first_step=first_step)
        streams = np.random.SeedSequence(entropy=seed, spawn_key=(number,)).spawn(runs)
        estimation = estimator.start(EpisodicEnv(mdp), policy, streams)
        values, gradients = mean_estimates(estimation, theta, runs, episodes, warm_up)
        length = 1 / mdp.restarted.average_rewards(table)[-1]
        scale = mdp.rewards.std(axis=(1, 2)) * np.where(by_episode, length, 1.0)
        check_averages(exact, values, bias * scale, z, [f"per {kind}, " for kind in kinds])
        check_gradients(slopes, gradients, bias, z, up_to_scale=up_to_scale)


def _draw_episodic_mdp(rng: np.random.Generator, table: np.ndarray) -> EpisodicMDP:
    """Action 0 soon ends the episode, action 1 does not. Of _CANDIDATES rewards for a channel the steepest stay."""
    transitions = rng.dirichlet(np.ones(_STATES), size=(_STATES, _ACTIONS))
    quits = np.stack([rng.uniform(*bounds, size=_STATES) for bounds in _QUITS], axis=1)
    count = len(_OFFSETS) * _CANDIDATES
    by_state, by_pair = rng.standard_normal((count, _STATES, 1)), rng.standard_normal((count, _STATES, _ACTIONS))
    rewards = np.repeat(_OFFSETS, _CANDIDATES)[:, None, None] + 0.3 * by_state + by_pair
    drawn, size = EpisodicMDP(transitions, quits, rewards), np.sqrt((rewards**2).mean(axis=(1, 2)))
    slopes = np.array(
        [np.linalg.norm(drawn.averages(table, np.full(count, kind))[1], axis=1) / size for kind in (False, True)]
    )
    least = (slopes / slopes.mean(axis=1, keepdims=True)).min(axis=0)  # of both averages
    steepest = np.arange(0, count, _CANDIDATES) + least.reshape(-1, _CANDIDATES).argmax(axis=1)
    return EpisodicMDP(transitions, quits, rewards[steepest])
