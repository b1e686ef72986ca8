"""Training: records, first parameters, updates in compiled code, what is wrong and who says so."""

import pickle
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep, Linearization
from envs import TabularMDP, ThreeStateMDP, random_mdp
from rl import (
    CPGRL,
    GPOMDP,
    DivergenceError,
    Estimate,
    SoftmaxTable,
    TrainingRecord,
    WeightedSum,
    map_runs,
    train,
    uniform_parameters,
)
from rl.estimators.finite_gpomdp import FiniteGPOMDP
from rl.streams import run_streams

from .stand_ins import streams

CPGRL_LEARNER = CPGRL(ConstrainedStep(), [0, 0, 0])
SETTING: Any = (ThreeStateMDP(), SoftmaxTable(3, 3), GPOMDP())


def test_a_record_holds_the_estimate_before_and_the_parameters_after_the_update() -> None:
    records = list(train(*SETTING, WeightedSum(), episodes=5, runs=3))
    assert [record.episode for record in records] == [1, 2, 3, 4, 5]
    before = np.zeros((3, 9))
    for record in records:
        assert record.linearization.values.shape == (3, 4)
        np.testing.assert_array_equal(record.update.change, 0.02 * record.linearization.gradients.sum(axis=1))
        np.testing.assert_array_equal(record.parameters, before + record.update.change)
        np.testing.assert_array_equal(record.estimate.steps, 100)
        before = record.parameters


SHORT = GPOMDP(steps=12, average_rate=0.3)  # whose average is settled soon, and whose gradients are often 0


def numbers(record: TrainingRecord) -> list[np.ndarray]:
    estimate, update = record.estimate, record.update
    counts = [update.counts[name] for name in sorted(update.counts)]
    estimated = [estimate.values, estimate.gradients, estimate.steps, estimate.rewards, estimate.events]
    return [record.parameters, *estimated, update.change, update.active, update.stationary, *counts]


@pytest.mark.parametrize(
    ("mdp", "settings"),
    [
        (ThreeStateMDP(), {}),
        (ThreeStateMDP(), {"formulation": "restoring"}),
        (ThreeStateMDP(), {"formulation": "linearized", "slack_fraction": 0.5}),
        (ThreeStateMDP(), {"solver": "rosen"}),
        (random_mdp(np.random.default_rng(5), 4, 5, 3), {"formulation": "cone"}),
    ],
)
def test_updates_made_in_compiled_code_have_the_bits_of_those_that_somebody_observes(
    mdp: TabularMDP, settings: dict[str, Any]
) -> None:
    policy = SoftmaxTable(mdp.states, mdp.actions)
    thresholds = mdp.average_rewards(policy.probabilities())[1:]
    learner, initial = CPGRL(ConstrainedStep(**settings), thresholds), uniform_parameters(policy.parameters.size)
    train_some = partial(train, mdp, policy, SHORT, learner, episodes=100, runs=6, initial=initial)
    kinds: Counter[str] = Counter()
    for record, observed in zip(train_some(), train_some(observe=lambda *_: None), strict=True):
        kinds[type(record).__name__] += 1
        assert record.episode == observed.episode
        for array, other in zip(numbers(record), numbers(observed), strict=True):
            assert array.dtype == other.dtype
            np.testing.assert_array_equal(array, other)
    assert kinds["_LearnedRecord"] > 50
    assert kinds["TrainingRecord"] > 5


def test_records_of_compiled_updates_can_be_kept_pickled_and_changed() -> None:
    records = list(train(ThreeStateMDP(), SoftmaxTable(3, 3), SHORT, CPGRL_LEARNER, episodes=200, runs=2))
    last = records[-1]
    for array, other in zip(numbers(last), numbers(pickle.loads(pickle.dumps(last))), strict=True):
        np.testing.assert_array_equal(array, other)
    changed = replace(last, episode=3)
    assert (type(changed), changed.episode) == (TrainingRecord, 3)
    np.testing.assert_array_equal(changed.parameters, last.parameters)
    assert last.parameters.base is None  # its own array: what is kept keeps no block of episodes


def test_an_update_that_goes_too_far_ends_training_after_the_same_record_observed_or_not() -> None:
    def episodes(observe: Any) -> tuple[int, str]:
        records = train(
            ThreeStateMDP(), SoftmaxTable(3, 3), SHORT, CPGRL_LEARNER, episodes=9999, runs=3, observe=observe,
            max_change=0.04,
        )  # fmt: skip
        made: list[int] = []
        with pytest.raises(DivergenceError) as error:
            made.extend(record.episode for record in records)
        return made[-1], str(error.value)

    unobserved = episodes(None)
    assert unobserved == episodes(lambda *_: None)
    assert unobserved[0] > 20


SETTLED = GPOMDP(bias_correction=False)  # from the first episode on


def test_thresholds_that_do_not_fit_do_not_go_into_compiled_code() -> None:
    with pytest.raises(ValueError, match=r"thresholds should have shape \(3,\); found \(2,\)"):
        next(train(ThreeStateMDP(), SoftmaxTable(3, 3), SETTLED, CPGRL(ConstrainedStep(), [0, 0]), episodes=1, runs=1))


class OwnLearner(CPGRL):
    pass


class OwnStep(ConstrainedStep):
    pass


class OwnEstimation(FiniteGPOMDP):
    def episode(self, parameters: np.ndarray) -> Estimate:
        return super().episode(parameters)


class OwnEstimator(GPOMDP):
    def with_driver(self, driver: Any) -> Any:
        return OwnEstimation(self, driver)


def test_whoever_has_code_of_its_own_is_not_passed_over_by_compiled_code() -> None:
    def is_plain(estimator: Any, learner: Any) -> bool:
        *_, record = train(ThreeStateMDP(), SoftmaxTable(3, 3), estimator, learner, episodes=3, runs=2)
        return type(record) is TrainingRecord

    assert not is_plain(SETTLED, CPGRL_LEARNER)
    assert is_plain(SETTLED, OwnLearner(ConstrainedStep(), [0, 0, 0]))
    assert is_plain(SETTLED, CPGRL(OwnStep(), [0, 0, 0]))
    assert is_plain(SETTLED, CPGRL(lambda *arguments: OwnStep()(*arguments), [0, 0, 0]))  # type: ignore[arg-type]
    assert is_plain(OwnEstimator(bias_correction=False), CPGRL_LEARNER)


def test_first_parameters_come_from_the_runs_own_stream() -> None:
    policy = SoftmaxTable(3, 3)
    learner = WeightedSum(step_size=0.0)
    (record,) = train(
        ThreeStateMDP(), policy, GPOMDP(), learner, episodes=1, runs=[4, 9], seed=3, initial=uniform_parameters(9)
    )
    for row, run in zip(record.parameters, (4, 9), strict=True):
        np.testing.assert_array_equal(row, np.random.default_rng(run_streams(3, run).initial).uniform(0, 1, 9))
    (record,) = train(ThreeStateMDP(), policy.with_parameters(np.arange(9.0)), GPOMDP(), learner, episodes=1, runs=2)
    np.testing.assert_array_equal(record.parameters, [np.arange(9.0)] * 2)


def test_map_runs_keeps_order_and_passes_exceptions_on() -> None:
    assert map_runs(list, 5, processes=2, threads=True) == [[0, 1], [2, 3, 4]]
    assert map_runs(list, range(7, 9), processes=8, threads=True) == [[7], [8]]

    def fail(runs: Sequence[int]) -> None:
        raise ZeroDivisionError(f"run {runs[0]}")

    with pytest.raises(ZeroDivisionError):
        map_runs(fail, 4, processes=2, threads=True)


def test_an_estimate_that_is_not_finite_names_the_run_and_the_channel() -> None:
    def break_off(parameters: np.ndarray) -> Any:
        estimate = inner.episode(parameters)
        estimate.gradients[1, 2, 3] = np.inf
        return estimate

    inner = GPOMDP().start(ThreeStateMDP(), SoftmaxTable(3, 3), streams(2))
    broken: Any = SimpleNamespace(start=lambda *_: SimpleNamespace(episode=break_off))
    with pytest.raises(DivergenceError, match="channel 2 in run 8, episode 1, should be finite; found"):
        next(train(ThreeStateMDP(), SoftmaxTable(3, 3), broken, WeightedSum(), episodes=9, runs=[3, 8]))


@pytest.mark.parametrize(
    "learner", [WeightedSum(step_size=1e150), CPGRL(ConstrainedStep(step_size=1e150), [0.0, 0.0, 0.0])]
)
def test_an_overflowing_update_raises_instead_of_training_on(learner: Any) -> None:
    mdp = TabularMDP(ThreeStateMDP().transitions, 1e200 * ThreeStateMDP().rewards)
    with pytest.raises(DivergenceError, match="should be finite"):
        for _ in train(mdp, SoftmaxTable(3, 3), GPOMDP(), learner, episodes=50, runs=2):
            pass


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"episodes": -1}, "episodes should be"),
        ({"episodes": 10**23}, "episodes should be an integer ≤"),
        ({"runs": 0}, "runs should be"),
        ({"runs": [0, 0]}, r"runs should be .*differ.*; found \[0, 0\]"),
        ({"runs": 10**12}, "runs should be .*; found"),
        ({"initial": np.zeros(9)}, "initial should be a function"),
        ({"max_change": np.nan}, "max_change should be"),
        ({"initial": lambda _: np.zeros(3)}, r"initial should return .*: parameters should have shape \(9,\)"),
        ({"initial": lambda _: None}, r"initial should return θ of shape \(9,\), finite numbers: .*None"),
    ],
)
def test_bad_input_is_refused_before_the_first_episode(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        train(*SETTING, WeightedSum(), **{"episodes": 1, **settings})


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, "the learner's update should return a LearnerUpdate; found None"),
        ({"change": np.zeros((2, 1))}, "the learner's change should be numbers of shape (2, 9); found float64, (2, 1)"),
        ({"change": np.full((2, 9), None)}, "the learner's change should be numbers of shape (2, 9); found object"),
    ],
)
def test_a_learner_that_returns_no_change_for_each_run_is_refused(answer: Any, message: str) -> None:
    """A change of another shape would spread over runs or components without a word."""

    class Returning:
        def update(self, linearization: Linearization, memory: Any = None, observe: Any = None) -> Any:  # noqa: ARG002
            return replace(WeightedSum().update(linearization), **answer) if isinstance(answer, dict) else answer

    with pytest.raises(ValueError, match=re.escape(message)):
        list(train(*SETTING, Returning(), episodes=1, runs=2))


def test_an_estimator_that_starts_or_estimates_nothing_is_refused() -> None:
    setting = ThreeStateMDP(), SoftmaxTable(3, 3)
    idle = SimpleNamespace(start=lambda *_: None)
    with pytest.raises(ValueError, match=r"the estimator's start should return an Estimation .*; found None"):
        train(*setting, idle, WeightedSum(), episodes=1, runs=1)  # type: ignore[arg-type]
    silent = SimpleNamespace(start=lambda *_: SimpleNamespace(episode=lambda _: None))
    with pytest.raises(ValueError, match="the estimator's episode should return an Estimate; found None"):
        list(train(*setting, silent, WeightedSum(), episodes=1, runs=1))  # type: ignore[arg-type]


def test_importing_rl_is_light() -> None:
    heavy = ("numba", "joblib", "matplotlib", "scipy.optimize", "osqp", "qpsolvers", "cvxpy", "gymnasium")
    code = f"import sys, rl; print([name for name in {heavy} if name in sys.modules])"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


def test_a_block_of_updates_is_bounded_by_its_numbers() -> None:
    mdp = random_mdp(np.random.default_rng(5), 30, 5, 3)
    short = GPOMDP(steps=3, average_rate=0.9, weights="usual")
    learner = CPGRL(ConstrainedStep(), np.full(2, -10.0))
    last = list(train(mdp, SoftmaxTable(30, 5), short, learner, episodes=1500, runs=1))[-1]
    block = last._learned.gradients  # type: ignore[attr-defined]
    assert block.size <= 500_000
