"""Estimators in compiled continuous environments: = the plain path on the same draws; runs do not meet; endings."""

# ruff: noqa: ARG002 - stand-ins take what they ignore

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numba
import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep
from envs import RESET_SIGNATURE, STEP_SIGNATURE, ContinuousKernels, TwoLinkArm, random_state
from envs.interface.random_stream import uniform
from rl import CPGRL, GPOMDP, KondaActorCritic, NormalizedGaussianNetwork, map_runs, train
from rl.drivers import PythonDriver
from rl.streams import run_streams


@cache  # not compiled where another worker has the tests that need it
def reset_and_step() -> tuple[Any, Any]:
    @numba.njit(RESET_SIGNATURE)
    def reset(constants, random_state, state):
        state[0] = uniform(random_state)

    @numba.njit(STEP_SIGNATURE)
    def step(constants, state, action, random_state, reward):
        state[0] += constants[0] * action.sum() + 0.1 * (uniform(random_state) - 0.5)
        reward[0], reward[1] = state[0], action[0] - action[2] ** 2
        return 1 if state[0] < -1 else 2 if state[0] > 2 else 0

    return reset, step


class Drift:
    """A point that drifts off on either side: one state, three actions, two rewards, noise in the step."""

    reward_channels = 2

    def continuous_kernels(self) -> ContinuousKernels:
        return ContinuousKernels(1, 3, 2, np.array([0.1]), *reset_and_step(), 40, ("left", "right"))


ENVIRONMENTS = {"arm": TwoLinkArm(touch_radius=0.2, max_steps=60), "drift": Drift()}
ESTIMATORS = {
    "Konda": KondaActorCritic(trace_decay=0.9, average_rate=0.1, critic_rate=0.03),
    "GPOMDP": GPOMDP(trace_decay=0.9, average_rate=0.1, steps=1000),
    "GPOMDP, usual weights": GPOMDP(trace_decay=0.9, average_rate=0.1, weights="usual", steps=1000),
    "per episode": KondaActorCritic(average="episode"),
    "GPOMDP, per episode": GPOMDP(average="episode", steps=1000),
    "Konda as printed": KondaActorCritic(average="episode", gradient="episode mean"),
    "GPOMDP as printed": GPOMDP(average="episode", gradient="episode mean", steps=1000),
}


def network(environment: str, deviation: float = 0.8) -> NormalizedGaussianNetwork:
    if environment == "arm":
        return NormalizedGaussianNetwork(*TwoLinkArm().stops, (5, 8), 2, deviation=deviation)
    return NormalizedGaussianNetwork([-1.0], [2.0], (6,), 3, deviation=deviation)


def episode_streams(runs: int) -> list[np.random.SeedSequence]:
    return [run_streams(0, run).episodes for run in range(runs)]


# --- the same definition, the same draws -------------------------------------------------------------------------


class Replay:
    """The kernels as a Gymnasium environment, and the network's policy, on one run's random state."""

    event_key = "event"

    def __init__(self, kernels: ContinuousKernels, network: NormalizedGaussianNetwork, stream: Any) -> None:
        self.kernels, self.network = kernels, network
        self.words = random_state(stream)
        self.reward_channels, self.parameters = kernels.reward_channels, network.parameters

    def reset(self, seed: int) -> tuple[np.ndarray, dict[str, Any]]:
        self.state, self.steps = np.empty(self.kernels.state_size), 0
        self.kernels.reset(self.kernels.constants, self.words, self.state)
        return self.state.copy(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool, bool, dict[str, Any]]:
        reward = np.empty(self.reward_channels)
        event = self.kernels.step(self.kernels.constants, self.state, action, self.words, reward)
        self.steps += 1
        return self.state.copy(), reward, event > 0, self.steps == self.kernels.max_steps, {"event": event}

    def with_parameters(self, parameters: np.ndarray) -> "Replay":
        self.network = self.network.with_parameters(parameters)
        return self

    def sample(self, observation: np.ndarray, rng: object) -> np.ndarray:
        noise = [component for _ in range(0, self.network.dimensions, 2) for component in self.pair()]
        return self.network.mean(observation) + self.network.deviation * np.array(noise[: self.network.dimensions])

    def pair(self) -> tuple[float, float]:
        """The polar method."""
        while True:
            x, y = 2 * uniform(self.words) - 1, 2 * uniform(self.words) - 1
            if 0 < (s := x * x + y * y) < 1:
                return x * np.sqrt(-2 * np.log(s) / s), y * np.sqrt(-2 * np.log(s) / s)

    def score(self, observation: np.ndarray, action: np.ndarray) -> np.ndarray:
        return self.network.score(observation, action)


@pytest.mark.parametrize("environment", ENVIRONMENTS)
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_compiled_and_plain_path_agree_on_the_same_draws(estimator: str, environment: str) -> None:
    settings, policy, rng = ESTIMATORS[estimator], network(environment), np.random.default_rng(5)
    streams, kernels = episode_streams(3), ENVIRONMENTS[environment].continuous_kernels()  # type: ignore[attr-defined]
    compiled = settings.start(ENVIRONMENTS[environment], policy, streams)  # type: ignore[attr-defined]
    replays = [Replay(kernels, policy, stream) for stream in streams]
    plain = [settings.with_driver(PythonDriver(replay, replay, streams[:1], settings.steps)) for replay in replays]
    lengths = set()
    for _ in range(8):
        parameters = rng.normal(size=(3, len(policy.parameters)))
        fast = compiled.episode(parameters)
        for run in range(3):
            slow = plain[run].episode(parameters[run : run + 1])
            for name in ("values", "gradients", "rewards", "steps", "events"):
                np.testing.assert_allclose(getattr(fast, name)[run], getattr(slow, name)[0], rtol=1e-10, atol=1e-12)
            if isinstance(settings, KondaActorCritic):
                np.testing.assert_allclose(compiled.critics[run], plain[run].critics[0], rtol=1e-10, atol=1e-12)
        lengths |= set(fast.steps)
    assert len(lengths) > 3  # episodes did end by events, at different times


# --- endings -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_records_carry_each_runs_length_and_event(estimator: str) -> None:
    (record,) = train(
        TwoLinkArm(), network("arm"), ESTIMATORS[estimator], CPGRL(ConstrainedStep(), [0, 0]), episodes=1, runs=60
    )  # type: ignore[arg-type]
    estimate = record.estimate
    assert len(set(estimate.steps)) > 20
    assert set(estimate.events) <= {0, 1, 2, 3, 4}
    np.testing.assert_array_equal(estimate.steps[estimate.events == 0], 1000)
    np.testing.assert_array_equal(estimate.rewards[:, 2], np.array([0, 0, -1, 1, 0])[estimate.events])


@pytest.mark.parametrize("estimator", [KondaActorCritic, GPOMDP])
def test_the_shorter_time_limit_holds(estimator: Any) -> None:
    never = TwoLinkArm(touch_radius=1e-9, max_steps=30)
    for steps, length in ((12, 12), (100, 30)):
        estimation = estimator(steps=steps).start(never, network("arm"), episode_streams(2))
        estimate = estimation.episode(np.zeros((2, 80)))
        np.testing.assert_array_equal(estimate.steps, length)
        np.testing.assert_array_equal(estimate.events, 0)


# --- runs --------------------------------------------------------------------------------------------------------


def trained(runs: int | Sequence[int], estimator: str, environment: str) -> np.ndarray:
    """θ after each of some episodes, (runs, episodes, n)."""
    learner = CPGRL(ConstrainedStep(ridge=1e-4, max_restoration=0.1), [0.0] * (1 + (environment == "arm")))
    records = train(
        ENVIRONMENTS[environment], network(environment), ESTIMATORS[estimator], learner, episodes=8, runs=runs, seed=2
    )  # type: ignore[arg-type]
    return np.stack([record.parameters for record in records], axis=1)


@pytest.mark.parametrize("environment", ENVIRONMENTS)
@pytest.mark.parametrize("estimator", ["Konda", "GPOMDP"])
def test_a_run_is_bit_identical_for_any_batch_and_any_thread(estimator: str, environment: str) -> None:
    together = trained(5, estimator, environment)
    assert len(np.unique(together[:, -1], axis=0)) == 5
    np.testing.assert_array_equal(trained([2], estimator, environment), together[[2]])
    np.testing.assert_array_equal(trained([4, 1], estimator, environment), together[[4, 1]])
    task = partial(trained, estimator=estimator, environment=environment)
    np.testing.assert_array_equal(np.concatenate(map_runs(task, 5, processes=2, threads=True)), together)


def test_drivers_and_rules_load_from_the_disk_cache_in_a_new_process() -> None:
    modules = ("drivers.finite", "drivers.continuous", "estimators.gpomdp", "estimators.konda_actor_critic")
    program = f"""
from importlib import import_module
for name in {modules}:
    advance = import_module("rl." + name).advance
    print(sum(getattr(advance, "machine_code", advance).stats.cache_hits.values()))
"""
    for _ in range(2):  # compiled by the first one where they have not been
        answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert answer.stdout.split() == ["1"] * len(modules)


# --- the boundary ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("estimator", [KondaActorCritic(), GPOMDP()])
def test_a_policy_of_another_size_is_refused(estimator: Any) -> None:
    stops = TwoLinkArm().stops
    with pytest.raises(ValueError, match="policy should have 2 components of the action, as the environment; found 3"):
        estimator.start(TwoLinkArm(), NormalizedGaussianNetwork(*stops, (5, 8), 3), episode_streams(1))
    with pytest.raises(ValueError, match="policy should have 2 axes of the state, as the environment; found 1"):
        estimator.start(TwoLinkArm(), NormalizedGaussianNetwork([0], [1], (5,), 2), episode_streams(1))


@pytest.mark.parametrize("estimator", [KondaActorCritic(steps=30), GPOMDP(steps=30)])
def test_the_plain_path_takes_the_network_too(estimator: Any) -> None:
    """Through Gymnasium's wrappers, which hand no kernels on."""
    import gymnasium

    environment = gymnasium.make("cpgrl/TwoLinkArm-v0")
    estimation = estimator.start(environment, network("arm"), episode_streams(2))
    estimate = estimation.episode(np.zeros((2, 80)))
    assert isinstance(estimation.driver, PythonDriver)
    assert estimate.values.shape == (2, 3)
    assert (estimate.steps <= 30).all()


def test_replacing_a_setting_keeps_the_others() -> None:
    settings = KondaActorCritic(average=["step", "episode"])  # type: ignore[arg-type]
    assert replace(settings, steps=7) == KondaActorCritic(average=("step", "episode"), steps=7)
