"""`check_gradient_estimator`: right estimators pass, each known-bad one is told what should be."""

from dataclasses import replace

import numpy as np
import pytest

from rl import GPOMDP, KondaActorCritic
from rl.estimators import ExactGradient
from rl.testing import ContractBroken, check_gradient_estimator

SMALL = {"runs": 60, "episodes": 25, "warm_up": 3, "mdps": 1}


class Spoilt:
    """GPOMDP with one thing spoilt."""

    def __init__(self, fault="", carried=None):
        self.fault, self.carried, self.starts = fault, carried, 0

    def start(self, environment, policy, streams):
        self.starts += 1
        settings = GPOMDP(weights="usual", trace_decay=0.0 if self.fault == "dropped trace" else 0.9)
        if self.fault == "unseeded":
            streams = np.random.SeedSequence(self.starts).spawn(len(streams))
        if self.fault == "one stream for all":
            streams = streams[:1] * len(streams)
        kind = Runs if self.carried is None else type("Carrying", (Runs,), {"carried": self.carried})
        return kind(self.fault, settings.start(environment, policy, streams))


class Runs:
    def __init__(self, fault, inner):
        self.fault, self.inner, self.kept = fault, inner, None

    def episode(self, parameters):
        found = self.inner.episode(parameters)
        values, gradients = found.values, found.gradients
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
        if self.fault == "one array":
            self.kept = gradients if self.kept is None else self.kept
            self.kept[:] = gradients
            gradients = self.kept
        return replace(found, values=values, gradients=gradients)


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
        (KondaActorCritic(steps=200), {"up_to_scale": True, "runs": 40}),
        (ExactGradient(), {"runs": 3, "episodes": 2, "warm_up": 0}),
        (Spoilt(), SMALL),
    ],
    ids=["GPOMDP", "Konda", "exact", "short"],
)
def test_a_right_estimator_passes(estimator, options):
    check_gradient_estimator(estimator, **options)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_bad_estimator_is_told_what_should_be(fault):
    with pytest.raises(ContractBroken, match=FAULTS[fault]):
        check_gradient_estimator(Spoilt(fault), **SMALL)


def test_an_estimator_of_the_right_direction_and_the_wrong_length_passes_only_up_to_scale():
    with pytest.raises(ContractBroken, match=r"cosine (1\.000|0\.99)"):
        check_gradient_estimator(KondaActorCritic(steps=200), runs=40, mdps=1)


def test_up_to_scale_is_not_up_to_sign():
    with pytest.raises(ContractBroken, match=r"Δ of channel 0"):
        check_gradient_estimator(Spoilt("cost instead of reward"), **SMALL, up_to_scale=True)


def test_too_few_samples_to_tell_are_not_taken_for_a_success():
    with pytest.raises(ContractBroken, match="more runs or episodes"):
        check_gradient_estimator(GPOMDP(), runs=3, episodes=1, bias=5.0)


def test_what_is_carried_is_named_whole_or_not_at_all():
    with pytest.raises(ContractBroken, match="goes on from what `carried` names; found a difference of"):
        check_gradient_estimator(Spoilt(carried=("kept",)), **SMALL)
    check_gradient_estimator(Spoilt(carried=("kept", "inner")), **SMALL)
