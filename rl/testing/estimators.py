"""`check_gradient_estimator`: estimates against exact averages and gradients of random finite MDPs."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cpgrl_opt.arrays import Float
from envs import TabularMDP

from ..carried import put_back, state_of
from ..policies import SoftmaxTable
from .contract import ContractBroken, isolatable, require

_STATES, _ACTIONS, _CHANNELS = 4, 3, 3
_AVERAGES = np.array([0.1, -0.05, 0.05])
_CANDIDATES = 6
_BLIND = 0.35  # of ‖∇gⁱ‖: an error of this size must stand out from the noise, or the check says nothing


@isolatable
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
    up_to_scale: for an estimator whose Δ is only proportional to ∇g, as `KondaActorCritic` at the paper's rates; each
    Δⁱ is scaled by the positive number that fits best.
    bias: what trace_decay < 1 and short episodes cost; see the estimator's own statement.
    time_limit, memory_limit: where either is given, as seconds and bytes, the check runs in a process of its own, and
    what hangs or crashes there is ContractBroken too (`contract.isolatable`).
    Not seen: errors below the bias allowed; environments with real vectors as states.
    """
    for number in range(mdps):
        rng = np.random.default_rng([seed, number])
        policy, theta = SoftmaxTable(_STATES, _ACTIONS), rng.normal(0.0, 0.5, _STATES * _ACTIONS)
        mdp = _slow_mdp(rng, policy.probabilities(theta))
        streams = np.random.SeedSequence(entropy=seed, spawn_key=(number,)).spawn(runs)
        _check_streams(estimator, mdp, policy, theta, seed)
        _check_carried(estimator, mdp, policy, theta, seed)
        estimation = estimator.start(mdp, policy, streams)
        parameters = np.tile(theta, (runs, 1))
        for _ in range(warm_up):
            estimation.episode(parameters)
        values, gradients = np.zeros((runs, _CHANNELS)), np.zeros((runs, _CHANNELS, theta.size))
        for _ in range(episodes):
            estimate = estimation.episode(parameters)
            values += estimate.values / episodes
            gradients += estimate.gradients / episodes
        _check_averages(mdp, policy.probabilities(theta), values, z)
        exact = mdp.policy_gradients(policy.probabilities(theta)).reshape(_CHANNELS, -1)
        if up_to_scale:
            gradients = scaled(gradients, exact)
        check_gradients(exact, gradients, bias, z)


def _slow_mdp(rng: np.random.Generator, table: np.ndarray) -> TabularMDP:
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
    together = _three_episodes(estimator, mdp, policy, parameters, seed, (0, 1, 2))
    for name, again in (
        ("the same streams", _three_episodes(estimator, mdp, policy, parameters, seed, (0, 1, 2))),
        (
            "each run alone",
            _joined([_three_episodes(estimator, mdp, policy, parameters, seed, (k,)) for k in range(3)]),
        ),
    ):
        for what, one, other in zip(("values", "gradients"), together, again, strict=True):
            require(
                np.array_equal(one, other),
                f"{what} should be the same bits from {name}: a run is a function of its stream and θ",
                f"a difference of {np.abs(one - other).max():.3g}",
            )


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
        for what in ("values", "gradients"):
            own, again = getattr(one, what), getattr(other, what)
            require(
                np.array_equal(own, again),
                f"{what} should be the same bits where another estimation goes on from what `carried` names",
                f"a difference of {np.abs(own - again).max():.3g}: something else is carried too",
            )


def _joined(runs: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    values, gradients = zip(*runs, strict=True)
    return np.concatenate(values, axis=1), np.concatenate(gradients, axis=1)


def _three_episodes(
    estimator: Any, mdp: TabularMDP, policy: SoftmaxTable, parameters: np.ndarray, seed: int, runs: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    streams = [np.random.SeedSequence(entropy=seed, spawn_key=(99, run)) for run in runs]
    estimation = estimator.start(mdp, policy, streams)
    own = parameters[list(runs)]
    before, estimates, copies = own.copy(), [], []
    for _ in range(3):
        estimate = estimation.episode(own)
        shape = (len(runs), _CHANNELS)
        require(np.shape(estimate.values) == shape, f"values should have shape {shape}", np.shape(estimate.values))
        wide, found = (*shape, parameters.shape[1]), np.shape(estimate.gradients)
        require(found == wide, f"gradients should have shape {wide}", found)
        for name in ("values", "gradients"):
            require(np.isfinite(getattr(estimate, name)).all(), f"{name} should be finite", getattr(estimate, name))
        estimates.append(estimate)
        copies.append((estimate.values.copy(), estimate.gradients.copy()))
    require(np.array_equal(own, before), "parameters should not be written to", "changed parameters")
    for estimate, (values, gradients) in zip(estimates, copies, strict=True):
        fresh = np.array_equal(estimate.values, values) and np.array_equal(estimate.gradients, gradients)
        require(fresh, "each estimate should have arrays of its own", "arrays that a later episode wrote to")
    return np.stack([values for values, _ in copies]), np.stack([gradients for _, gradients in copies])


def _check_averages(mdp: TabularMDP, table: np.ndarray, values: Float[np.ndarray, "R channels"], z: float) -> None:
    exact, error = mdp.average_rewards(table), values.std(axis=0, ddof=1) / np.sqrt(len(values))
    spread = mdp.rewards.std(axis=(1, 2))
    for channel, found in enumerate(values.mean(axis=0)):
        allowed = 0.02 * spread[channel] + z * error[channel]
        require(
            abs(found - exact[channel]) <= allowed,
            f"ρ of channel {channel} should be the exact average {exact[channel]:.4g} within {allowed:.2g}",
            f"{found:.4g} ± {error[channel]:.1g} (standard error){_mixed_up(found, exact, channel, allowed)}",
        )


def scaled(gradients: Float[np.ndarray, "R channels n"], exact: np.ndarray) -> Float[np.ndarray, "R channels n"]:
    """Each Δⁱ times the positive number that fits best."""
    mean = gradients.mean(axis=0)
    factor = np.einsum("cn,cn->c", mean, exact) / np.maximum(np.einsum("cn,cn->c", mean, mean), 1e-300)
    return np.asarray(np.where(factor > 0, factor, 1.0)[:, None] * gradients)


def check_gradients(
    exact: Float[np.ndarray, "channels n"], gradients: Float[np.ndarray, "R channels n"], bias: float, z: float
) -> None:
    """‖mean Δⁱ − ∇ρⁱ‖ ≤ bias·‖∇ρⁱ‖ + z·SE for every channel, and z·SE small enough for an error to show."""
    mean, error = gradients.mean(axis=0), np.sqrt((gradients.var(axis=0, ddof=1) / len(gradients)).sum(axis=1))
    for channel in range(len(exact)):
        size = np.linalg.norm(exact[channel])
        off, allowed = np.linalg.norm(mean[channel] - exact[channel]), bias * size + z * error[channel]
        cosine = mean[channel] @ exact[channel] / max(np.linalg.norm(mean[channel]) * size, 1e-300)
        if off > allowed:
            raise ContractBroken(
                f"Δ of channel {channel} should be ∇g{channel}, of length {size:.3g}, within {allowed:.2g}; found it "
                f"off by {off:.3g} ({off / size:.0%}), cosine {cosine:.3f}, length {np.linalg.norm(mean[channel]):.3g}"
            )
        require(
            z * error[channel] <= _BLIND * size,
            f"the standard error of Δ of channel {channel} should be below {_BLIND / z * size:.2g}, for an error of "
            f"{_BLIND:.0%} to show: more runs or episodes",
            f"{error[channel]:.2g}",
        )


def _mixed_up(found: float, exact: np.ndarray, channel: int, allowed: float) -> str:
    others = [k for k in range(len(exact)) if k != channel and abs(found - exact[k]) <= allowed]
    return f": that is channel {others[0]}'s" if others else ""
