"""`check_gradient_estimator`: estimates against exact averages and gradients of random finite MDPs."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cpgrl_opt.arrays import Float
from envs import TabularMDP

from .._carried import put_back, state_of
from ..policies import SoftmaxTable
from .contract import allow_limits, require

_STATES, _ACTIONS, _CHANNELS = 4, 3, 3
_AVERAGES = np.array([0.1, -0.05, 0.05])
_CANDIDATES = 6
_PARTS = ("values", "gradients")  # of an estimate
# Of ‖∇gⁱ‖: an error of this size must stand out from the noise, or the check says nothing. Half of it would take four
# times as many episodes; of errors as large as the gradient itself the check would be no check.
_BLIND = 0.35


@allow_limits
def check_gradient_estimator(
    estimator: Any,
    *,
    mdps: int = 2,
    runs: int = 200,
    episodes: int = 60,
    warm_up: int = 20,
    bias: float = 0.1,
    up_to_scale: bool = False,
    seed: int = 0,
    z: float = 5.0,
) -> None:
    """ContractBroken at the first thing in which an estimator is not what training and learners rely on.

    On `mdps` random MDPs of 4 states, 3 actions, 3 channels, with a random `SoftmaxTable` each (a fixed θ):
    - shapes (B, 1 + m) and (B, 1 + m, n), finite, fresh arrays each episode, `parameters` not written to;
    - the same streams give the same bits, and run i is the same bits alone as beside others;
    - where the estimation names in `carried` what it carries, another one goes on from that with the same bits;
    - ‖mean Δⁱ − ∇gⁱ‖ ≤ bias·‖∇gⁱ‖ + z·SE and |mean ρⁱ − gⁱ| ≤ 0.02·sd(rⁱ) + z·SE for every channel i, where the mean
      is over `episodes` episodes of `runs` runs after `warm_up` episodes (what is carried from episode to episode
      settles), and SE, the standard error, is from the runs, which are independent.
    ContractBroken too where z·SE exceeds 0.35 ‖∇gⁱ‖: then too little was sampled to tell.

    Parameters
    ----------
    bias
        What trace_decay < 1 and short episodes cost; see the estimator's own statement.
    up_to_scale
        For an estimator whose Δ is only proportional to ∇g, as `KondaActorCritic` at the paper's rates; each Δⁱ is
        scaled by the positive number that fits best.
    time_limit, memory_limit
        Where either is given, as seconds and bytes, the check runs in a process of its own, and what hangs or crashes
        there is ContractBroken too.

    Notes
    -----
    Not seen: errors below the bias allowed; environments with real vectors as states.
    """
    for number in range(mdps):
        rng = np.random.default_rng([seed, number])
        policy, theta = SoftmaxTable(_STATES, _ACTIONS), rng.normal(0.0, 0.5, _STATES * _ACTIONS)
        mdp = _draw_slow_mdp(rng, policy.probabilities(theta))
        _check_streams(estimator, mdp, policy, theta, seed)
        _check_carried(estimator, mdp, policy, theta, seed)
        streams = np.random.SeedSequence(entropy=seed, spawn_key=(number,)).spawn(runs)
        values, gradients = mean_estimates(estimator.start(mdp, policy, streams), theta, runs, episodes, warm_up)
        table = policy.probabilities(theta)
        check_averages(mdp.average_rewards(table), values, 0.02 * mdp.rewards.std(axis=(1, 2)), z)
        exact = mdp.policy_gradients(table).reshape(_CHANNELS, -1)
        check_gradients(exact, gradients, bias, z, up_to_scale=up_to_scale)


def mean_estimates(
    estimation: Any, theta: np.ndarray, runs: int, episodes: int, warm_up: int
) -> tuple[Float[np.ndarray, "R channels"], Float[np.ndarray, "R channels n"]]:
    """Each run's mean of ρ and of Δ over episodes at a fixed θ, after others in which what is carried settles."""
    parameters = np.tile(theta, (runs, 1))
    for _ in range(warm_up):
        estimation.episode(parameters)
    estimates = [estimation.episode(parameters) for _ in range(episodes)]
    values, gradients = (np.mean([getattr(each, name) for each in estimates], axis=0) for name in _PARTS)
    return values, gradients


def _draw_slow_mdp(rng: np.random.Generator, table: np.ndarray) -> TabularMDP:
    """An action mostly decides where one goes next, so that an action's worth lies in what comes after.

    Averages under the policy are _AVERAGES: small beside the rewards' spread, since they are noise to a gradient
    that has no baseline. Of _CANDIDATES rewards for a channel that with the steepest gradient stays, for the same end.
    """
    shape = (_STATES, _ACTIONS)
    goal = np.eye(_STATES)[rng.permuted(np.tile(np.arange(_STATES), (_STATES, 1)), axis=1)[:, :_ACTIONS]]
    transitions = 0.7 * goal + 0.3 * rng.dirichlet(np.ones(_STATES), size=shape)
    count = _CHANNELS * _CANDIDATES
    by_state, by_pair = rng.standard_normal((count, _STATES, 1)), rng.standard_normal((count, *shape))
    rewards = by_state + 0.3 * by_pair
    drawn = TabularMDP(transitions, rewards)
    slope = np.linalg.norm(drawn.policy_gradients(table).reshape(count, -1), axis=1) / rewards.std(axis=(1, 2))
    steepest = np.arange(0, count, _CANDIDATES) + slope.reshape(_CHANNELS, _CANDIDATES).argmax(axis=1)
    centred = rewards[steepest] - drawn.average_rewards(table)[steepest, None, None]
    return TabularMDP(transitions, centred + _AVERAGES[:, None, None])


def _check_streams(estimator: Any, mdp: TabularMDP, policy: SoftmaxTable, theta: np.ndarray, seed: int) -> None:
    parameters = theta + np.linspace(0.0, 0.3, 3)[:, None]

    def play(*runs: int) -> list[np.ndarray]:
        streams = [np.random.SeedSequence(entropy=seed, spawn_key=(99, run)) for run in runs]
        return _play_three_episodes(estimator.start(mdp, policy, streams), parameters[list(runs)])

    together, alone = play(0, 1, 2), zip(*(play(run) for run in range(3)), strict=True)
    for name, again in (
        ("the same streams", play(0, 1, 2)),
        ("each run alone", [np.concatenate(runs, axis=1) for runs in alone]),
    ):
        for what, one, other in zip(_PARTS, together, again, strict=True):
            _require_same(
                one, other, f"{what} should be the same bits from {name}: a run is a function of its stream and θ"
            )


def _require_same(one: np.ndarray, other: np.ndarray, should: str, why: str = "") -> None:
    require(np.array_equal(one, other), should, f"a difference of {np.abs(one - other).max():.3g}{why}")


def _check_carried(estimator: Any, mdp: TabularMDP, policy: SoftmaxTable, theta: np.ndarray, seed: int) -> None:
    """What `Training.save` relies on."""
    streams, parameters = np.random.SeedSequence(entropy=seed, spawn_key=(98,)).spawn(2), np.tile(theta, (2, 1))
    first, second = (estimator.start(mdp, policy, streams) for _ in range(2))
    if not hasattr(type(first), "carried"):
        return
    for _ in range(2):
        first.episode(parameters)
    put_back(second, state_of(first))
    for _ in range(2):
        one, other = first.episode(parameters), second.episode(parameters)
        for what in _PARTS:
            should = f"{what} should be the same bits where another estimation goes on from what `carried` names"
            _require_same(getattr(one, what), getattr(other, what), should, ": something else is carried too")


def _play_three_episodes(estimation: Any, parameters: np.ndarray) -> list[np.ndarray]:
    """ρ and Δ of three episodes, (3, B, …) each; what is checked of any estimate on the way."""
    before, estimates, copies = parameters.copy(), [], []
    shape = (len(parameters), _CHANNELS)
    for _ in range(3):
        estimate = estimation.episode(parameters)
        for name, wanted in zip(_PARTS, (shape, (*shape, parameters.shape[1])), strict=True):
            found = getattr(estimate, name)
            require(np.shape(found) == wanted, f"{name} should have shape {wanted}", np.shape(found))
            require(np.isfinite(found).all(), f"{name} should be finite", found)
        estimates.append(estimate)
        copies.append([getattr(estimate, name).copy() for name in _PARTS])
    require(np.array_equal(parameters, before), "parameters should not be written to", "changed parameters")
    for estimate, own in zip(estimates, copies, strict=True):
        fresh = all(np.array_equal(getattr(estimate, name), part) for name, part in zip(_PARTS, own, strict=True))
        require(fresh, "each estimate should have arrays of its own", "arrays that a later episode wrote to")
    return [np.stack(parts) for parts in zip(*copies, strict=True)]


def check_averages(
    exact: Float[np.ndarray, "channels"],
    values: Float[np.ndarray, "R channels"],
    off: Float[np.ndarray, "channels"],
    z: float,
    kinds: Sequence[str] = ("",) * _CHANNELS,
) -> None:
    """|mean ρⁱ − its exact value| ≤ offⁱ + z·SE for every channel; kinds: what each average is, in words."""
    error = values.std(axis=0, ddof=1) / np.sqrt(len(values))
    for channel, found in enumerate(values.mean(axis=0)):
        allowed = off[channel] + z * error[channel]
        others = [k for k in range(len(exact)) if k != channel and abs(found - exact[k]) <= allowed]
        mixed_up = f": that is channel {others[0]}'s" if others else ""
        should = f"ρ of channel {channel} should be the exact average {kinds[channel]}{exact[channel]:.4g}"
        told = f"{found:.4g} ± {error[channel]:.1g} (standard error){mixed_up}"
        require(abs(found - exact[channel]) <= allowed, f"{should} within {allowed:.2g}", told)


def check_gradients(
    exact: Float[np.ndarray, "channels n"],
    gradients: Float[np.ndarray, "R channels n"],
    bias: float,
    z: float,
    *,
    up_to_scale: bool,
) -> None:
    """‖mean Δⁱ − ∇ρⁱ‖ ≤ bias·‖∇ρⁱ‖ + z·SE for every channel, and z·SE small enough for an error to show.

    up_to_scale: each Δⁱ is first multiplied by the positive number that fits best.
    """
    if up_to_scale:
        mean = gradients.mean(axis=0)
        factor = (mean * exact).sum(axis=1) / np.maximum((mean * mean).sum(axis=1), 1e-300)
        gradients = np.where(factor > 0, factor, 1.0)[:, None] * gradients
    mean, error = gradients.mean(axis=0), np.sqrt((gradients.var(axis=0, ddof=1) / len(gradients)).sum(axis=1))
    for channel in range(len(exact)):
        size, length = np.linalg.norm(exact[channel]), np.linalg.norm(mean[channel])
        off, allowed = np.linalg.norm(mean[channel] - exact[channel]), bias * size + z * error[channel]
        cosine = mean[channel] @ exact[channel] / max(length * size, 1e-300)
        require(
            off <= allowed,
            f"Δ of channel {channel} should be ∇g{channel}, of length {size:.3g}, within {allowed:.2g}",
            f"it off by {off:.3g} ({off / size:.0%}), cosine {cosine:.3f}, length {length:.3g}",
        )
        require(
            z * error[channel] <= _BLIND * size,
            f"the standard error of Δ of channel {channel} should be below {_BLIND / z * size:.2g}, for an error of "
            f"{_BLIND:.0%} to show: more runs or episodes",
            f"{error[channel]:.2g}",
        )
