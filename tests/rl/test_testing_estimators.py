"""`check_gradient_estimator`: right estimators pass, each known-bad one is told what should be."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from rl import GPOMDP, KondaActorCritic
from rl.estimators import Estimate, ExactGradient
from rl.testing import ContractBroken, check_gradient_estimator

SMALL = {"runs": 60, "episodes": 25, "warm_up": 3, "mdps": 1}


@dataclass
class Plain:
    """GPOMDP (weights 1, β, …) on a finite MDP in NumPy, all runs side by side; `fault` spoils one thing."""

    fault: str = ""
    steps: int = 100

    def start(self, environment, policy, streams):
        return PlainRuns(self, environment, policy, streams)


class PlainRuns:
    def __init__(self, settings, mdp, policy, streams):
        self.fault, self.steps, self.mdp, self.policy = settings.fault, settings.steps, mdp, policy
        self.rngs = [np.random.default_rng(None if self.fault == "unseeded" else stream) for stream in streams]
        if self.fault == "one stream for all":
            self.rngs = [self.rngs[0]] * len(streams)
        self.kept = None

    def episode(self, parameters):
        runs, channels = len(self.rngs), self.mdp.reward_channels
        draws = np.stack([rng.random((self.steps, 2)) for rng in self.rngs])
        tables = self.policy.probabilities(parameters)
        each, states = np.arange(runs), np.full(runs, self.mdp.start)
        trace, gradients, rewards = np.zeros(tables.shape), np.zeros((runs, channels, *tables.shape[1:])), 0.0
        for t in range(self.steps):
            actions = (draws[:, t, :1] >= tables[each, states].cumsum(axis=1)[:, :-1]).sum(axis=1)
            reward = self.mdp.rewards[:, states, actions].T
            score = np.zeros(tables.shape)
            score[each, states, actions] = 1.0
            score[each, states] -= tables[each, states]
            past = 0.0 if self.fault == "dropped trace" else 0.9 * trace
            trace, rewards = past + score, rewards + reward
            gradients += reward[:, :, None, None] * trace[:, None]
            states = (draws[:, t, 1:] >= self.mdp.transitions[states, actions].cumsum(axis=1)[:, :-1]).sum(axis=1)
        return self.told(rewards / self.steps, gradients.reshape(runs, channels, -1) / self.steps, parameters)

    def told(self, values, gradients, parameters):
        if self.fault == "cost instead of reward":
            gradients = -gradients
        if self.fault == "channels swapped":
            gradients = gradients[:, [0, 2, 1]]
        if self.fault == "averages swapped":
            values = values[:, [1, 0, 2]]
        if self.fault == "one channel":
            gradients = gradients[:, :1]
        if self.fault == "NaN":
            values = values * np.nan
        if self.fault == "writes to θ":
            parameters += 0.01
        if self.fault == "one array" and self.kept is not None:
            self.kept[:] = gradients
        self.kept = gradients if self.kept is None or self.fault != "one array" else self.kept
        none = np.zeros(len(values), np.int64)
        return Estimate(values, self.kept, none + self.steps, values, none)


FAULTS = {
    "dropped trace": r"Δ of channel \d should be ∇g\d, .*; found it off by",
    "cost instead of reward": r"Δ of channel 0 should be ∇g0, .*cosine -0\.9",
    "channels swapped": r"Δ of channel 1 should be ∇g1",
    "averages swapped": r"ρ of channel 0 should be the exact average 0\.1 .*: that is channel 1's",
    "unseeded": "should be the same bits from the same streams",
    "one stream for all": "should be the same bits from each run alone",
    "one channel": r"gradients should have shape \(3, 3, 12\); found \(3, 1, 12\)",
    "NaN": "values should be finite",
    "writes to θ": "parameters should not be written to",
    "one array": "each estimate should have arrays of its own",
}


@pytest.mark.parametrize(
    ("estimator", "options"),
    [
        (GPOMDP(), {}),
        (GPOMDP(weights="usual"), {}),
        (KondaActorCritic(steps=200), {"up_to_scale": True, "runs": 40}),
        (ExactGradient(), {"runs": 3, "episodes": 2, "warm_up": 0}),
        (Plain(), SMALL),
    ],
    ids=["GPOMDP", "usual", "Konda", "exact", "plain"],
)
def test_a_right_estimator_passes(estimator, options):
    check_gradient_estimator(estimator, **options)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_bad_estimator_is_told_what_should_be(fault):
    with pytest.raises(ContractBroken, match=FAULTS[fault]):
        check_gradient_estimator(Plain(fault), **SMALL)


def test_an_estimator_of_the_right_direction_and_the_wrong_length_passes_only_up_to_scale():
    with pytest.raises(ContractBroken, match=r"cosine (1\.000|0\.99)"):
        check_gradient_estimator(KondaActorCritic(steps=200), runs=40, mdps=1)


def test_up_to_scale_is_not_up_to_sign():
    with pytest.raises(ContractBroken, match=r"Δ of channel 0"):
        check_gradient_estimator(Plain("cost instead of reward"), **SMALL, up_to_scale=True)


def test_too_few_samples_to_tell_are_not_taken_for_a_success():
    with pytest.raises(ContractBroken, match="more runs or episodes"):
        check_gradient_estimator(GPOMDP(), runs=3, episodes=1, bias=5.0)


@pytest.mark.parametrize("carried", [("kept",), ("kept", "rngs")])
def test_what_is_carried_is_named_whole_or_not_at_all(carried):
    runs = type("Runs", (PlainRuns,), {"carried": carried})
    estimator = SimpleNamespace(start=lambda *arguments: runs(Plain(), *arguments))
    if "rngs" in carried:
        check_gradient_estimator(estimator, **SMALL)
        return
    with pytest.raises(ContractBroken, match="goes on from what `carried` names; found a difference of"):
        check_gradient_estimator(estimator, **SMALL)
