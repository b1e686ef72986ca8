"""Every update rule runs with every driver: the same draws give the same estimates; a third rule, a fourth driver."""

# ruff: noqa: ARG002 - stand-ins take what they ignore

import pkgutil
import subprocess
import sys
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numba
import numpy as np
import pytest

from envs import (
    RESET_SIGNATURE,
    STEP_SIGNATURE,
    ContinuousKernels,
    TabularMDP,
    TwoLinkArm,
    random_mdp,
    random_state,
)
from envs.interface.random_stream import next_word, uniform
from rl import GPOMDP, KondaActorCritic, NormalizedGaussianNetwork, SoftmaxTable
from rl.drivers import PythonDriver, Rule, Score, account, close_run, open_run
from rl.estimators import SamplingEstimator

from .stand_ins import streams

FIELDS = ("values", "gradients", "rewards", "steps", "events")


# --- a third estimator -------------------------------------------------------------------------------------------


def climb(course, t, score, reward, following, last):
    """z ← z + ψ_t, Δⁱ ← Δⁱ + (rⁱ − bⁱ) z, where b is the mean return of earlier episodes a step, in the memory.

    A plain function, which compiled drivers interpret; the other rules are machine code.
    """
    trace = course.vectors[0]
    trace[score.place : score.place + score.values.size] += score.values
    for i in range(reward.size):
        course.gradients[i] += (reward[i] - course.memory[0, i]) * trace
        if last:
            course.memory[0, i] += 0.1 * (course.average[i] - course.memory[0, i])


@dataclass(frozen=True, kw_only=True)
class Reinforce(SamplingEstimator):
    """REINFORCE with an average baseline."""

    def rule(self, reported: Any) -> Rule:
        return Rule(climb, vectors=1, memory=1)


ESTIMATORS = {
    "Konda": KondaActorCritic,
    "Konda per episode": partial(KondaActorCritic, average="episode"),
    "Konda as printed": partial(KondaActorCritic, average="episode", gradient="episode mean", bias_correction=False),
    "GPOMDP": GPOMDP,
    "GPOMDP per episode": partial(GPOMDP, average="episode"),
    "GPOMDP usual": partial(GPOMDP, weights="usual"),
    "GPOMDP as printed": partial(GPOMDP, average="episode", gradient="episode mean", bias_correction=False),
    "REINFORCE": Reinforce,
}


def estimator_of(name: str, **settings: Any) -> Any:
    return ESTIMATORS[name](**settings, **({} if name == "REINFORCE" else {"trace_decay": 0.9}))  # type: ignore[operator]


# --- environments and their replays ------------------------------------------------------------------------------


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

    def __init__(self, rate: float = 0.1) -> None:
        self.rate = rate

    def continuous_kernels(self) -> ContinuousKernels:
        return ContinuousKernels(1, 3, 2, np.array([self.rate]), *reset_and_step(), 40, ("left", "right"))


MDPS = {  # states, actions, channels: one lane group and two; a search by counting and by bisection
    "six channels": random_mdp(np.random.default_rng(1), 4, 3, 6),
    "twenty actions": random_mdp(np.random.default_rng(2), 2, 20, 1),
    "twenty states": random_mdp(np.random.default_rng(3), 20, 2, 2),
}
ENVIRONMENTS: dict[str, Any] = {**MDPS, "drift": Drift()}


def policy_for(environment: Any) -> Any:
    if isinstance(environment, TabularMDP):
        return SoftmaxTable(environment.states, environment.actions)
    return NormalizedGaussianNetwork([-1.0], [2.0], (6,), 3, deviation=0.8)


class Replay:
    """An environment and its policy in Python, on the draws of the compiled drivers."""

    event_key = "event"

    def __init__(self, environment: Any, policy: Any, stream: np.random.SeedSequence) -> None:
        self.environment, self.policy, self.words = environment, policy, random_state(stream)
        self.parameters, self.reward_channels = policy.parameters, environment.reward_channels
        self.finite = isinstance(environment, TabularMDP)
        self.kernel = environment.finite_kernel() if self.finite else environment.continuous_kernels()

    def with_parameters(self, parameters: np.ndarray) -> "Replay":
        self.policy = self.policy.with_parameters(parameters)
        return self

    def reset(self, seed: int) -> tuple[Any, dict[str, Any]]:
        self.steps = 0
        if self.finite:
            self.state = self.kernel.start
            return self.state, {}
        self.state = np.empty(self.kernel.state_size)
        self.kernel.reset(self.kernel.constants, self.words, self.state)
        return self.state.copy(), {}

    def sample(self, observation: Any, rng: object) -> Any:
        """A word's high half takes the action, its low half moves; normals by the polar method."""
        if self.finite:
            word = int(next_word(self.words))
            self.low = (word & 0xFFFFFFFF) / 2**32
            below = np.cumsum(self.policy.probabilities()[observation])
            return min(int(np.searchsorted(below, (word >> 32) / 2**32, side="right")), self.policy.actions - 1)
        noise = [component for _ in range(0, self.policy.dimensions, 2) for component in self.pair()]
        return self.policy.mean(observation) + self.policy.deviation * np.array(noise[: self.policy.dimensions])

    def pair(self) -> tuple[float, float]:
        while True:
            x, y = 2 * uniform(self.words) - 1, 2 * uniform(self.words) - 1
            if 0 < (s := x * x + y * y) < 1:
                return x * np.sqrt(-2 * np.log(s) / s), y * np.sqrt(-2 * np.log(s) / s)

    def score(self, observation: Any, action: Any) -> np.ndarray:
        score: np.ndarray = self.policy.score(observation, action)
        return score

    def step(self, action: Any) -> tuple[Any, np.ndarray, bool, bool, dict[str, Any]]:
        if self.finite:
            reward, row = self.kernel.rewards[:, self.state, action], self.kernel.transition_cumulative
            self.state = int(np.searchsorted(row[self.state, action], self.low, side="right"))
            return self.state, reward, False, False, {}
        reward = np.empty(self.reward_channels)
        event = self.kernel.step(self.kernel.constants, self.state, action, self.words, reward)
        self.steps += 1
        return self.state.copy(), reward, event > 0, self.steps == self.kernel.max_steps, {"event": event}


@pytest.mark.parametrize("environment", ENVIRONMENTS)
@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_compiled_driver_and_python_agree_on_the_same_draws(name: str, environment: str) -> None:
    where, rng, of = ENVIRONMENTS[environment], np.random.default_rng(5), streams(3)
    policy = policy_for(where)
    # the estimator's limit is the shorter one, or the environment's, 40 steps
    settings = estimator_of(name, average_rate=0.1, steps=37 if environment in MDPS or "Konda" in name else 1000)
    compiled = settings.start(where, policy, of)
    replays = [Replay(where, policy, stream) for stream in of]
    each: list[Any] = [settings.with_driver(PythonDriver(own, own, of[:1], settings.steps)) for own in replays]
    lengths: set[int] = set()
    for _ in range(5):  # what is carried goes on, traces do not
        parameters = rng.normal(size=(3, len(policy.parameters)))
        fast = compiled.episode(parameters)
        for run in range(3):
            slow = each[run].episode(parameters[run : run + 1])
            for field in FIELDS:
                np.testing.assert_allclose(getattr(fast, field)[run], getattr(slow, field)[0], rtol=1e-10, atol=1e-12)
            if "Konda" in name:
                np.testing.assert_allclose(compiled.critics[run], each[run].critics[0], rtol=1e-10, atol=1e-12)
        lengths |= set(fast.steps)
    assert (len(lengths) > 3) == (environment not in MDPS)  # there episodes did end by events, at different times


# --- a fourth driver ---------------------------------------------------------------------------------------------


class Script:
    """Plays the scores and rewards that it is given, then ends by an event, or at the limit."""

    carried = ()

    def __init__(self, scores: Any, rewards: Any, event: int) -> None:
        self.scores, self.rewards, self.event = np.array(scores, float), np.array(rewards, float), event
        self.shape, self.limit = (1, self.rewards.shape[1], self.scores.shape[1]), len(self.rewards)

    def play(self, step: Any, parameters: np.ndarray, batch: Any) -> None:
        course = open_run(batch, 0)
        for t, reward in enumerate(self.rewards):
            last = t + 1 == self.limit
            following = np.zeros(self.shape[2]) if last and self.event else self.scores[t + 1]
            account(batch, 0, t, reward)
            step(course, t, Score(0, self.scores[t]), reward, Score(0, following), last)
        close_run(batch, 0, self.limit, self.event)

    def reorder(self, vectors: np.ndarray) -> np.ndarray:
        return vectors


@pytest.mark.parametrize("event", [0, 7])
def test_two_steps_of_konda_by_hand(event: int) -> None:
    """ψ = (1, 0), then (0, 2); rewards 3, then 5; β = ½, α_r = 0.1, α_w = 0.01; the second channel is −1 times it."""
    settings = KondaActorCritic(trace_decay=0.5, average_rate=0.1, critic_rate=0.01, bias_correction=False)
    script = Script([[1, 0], [0, 2], [1, 0]], [[3, -3], [5, -5]], event)
    konda: Any = settings.with_driver(script)
    first = konda.episode(np.zeros((1, 2)))
    # step 0: Q = 0; z = (1, 0); ρ = 0.3; δ = 3 − 0.3; w = 0.027 z
    # step 1: Q = 0; z = (0.5, 2); ρ = 0.3 + 0.1 (5 − 0.3) = 0.77; δ = 5 − 0.77 + wᵀ(ψ₂ − ψ₁), wᵀψ₁ = 0
    delta = 4.23 if event else 4.23 + 0.027  # ψ₂ = 0 after an event, else (1, 0) again
    w = np.array([0.027, 0.0]) + 0.01 * delta * np.array([0.5, 2.0])
    np.testing.assert_allclose(first.values, [[0.77, -0.77]])
    np.testing.assert_array_equal(first.gradients, 0)
    np.testing.assert_allclose(konda.critics, [[w, -w]])
    assert (first.steps[0], first.events[0], first.rewards.tolist()) == (2, event, [[8, -8]])
    second = konda.episode(np.zeros((1, 2)))  # ρ and w go on, z and Δ begin anew
    np.testing.assert_allclose(second.gradients[0, 0], [w[0] / 2, 4 * w[1] / 2])
    np.testing.assert_allclose(second.values[0, 0], 0.9 * (0.9 * 0.77 + 0.3) + 0.5)
    # Per episode no ρ is subtracted, and ψ₂ = 0 at the limit too, where a sum ends; Δ is the sum over both steps.
    summed: Any = replace(settings, average="episode").with_driver(script)
    summed.episode(np.zeros((1, 2)))
    w = np.array([0.03, 0.0]) + 0.01 * 5 * np.array([0.5, 2.0])
    np.testing.assert_allclose(summed.critics, [[w, -w]])
    # δ₀ = 3 − w₁ moves w along (1, 0) alone, so that step 1 finds the second component as it was.
    np.testing.assert_allclose(summed.episode(np.zeros((1, 2))).gradients[0, 0], [w[0], 4 * w[1]])


def test_three_steps_of_the_others_by_hand() -> None:
    """Scores 1, 2, 3 and rewards 5, 7, 11: z = 1, 2.5, 4.25 at β = ½, and 1, 3, 6 at β = 1."""
    script = partial(Script, [[1], [2], [3], [9]], [[5], [7], [11]])
    as_printed = GPOMDP(trace_decay=0.5, average="episode", gradient="episode mean")
    for settings, wanted in (
        (GPOMDP(weights="usual", trace_decay=0.5), (5 * 1 + 7 * 2.5 + 11 * 4.25) / 3),
        (GPOMDP(trace_decay=0.5), (7 * (1 + 2) + 11 * (2.5 + 3)) / 2),
        (as_printed, (7 * (1 + 2) + 11 * (2.5 + 3)) / 2),
        (GPOMDP(trace_decay=0.5, average="episode"), 5 * 1 + 7 * (1 + 2) + 11 * (2.5 + 3)),
        (Reinforce(average="episode"), 5 * 1 + 7 * 3 + 11 * 6),
    ):
        estimate = settings.with_driver(script(1)).episode(np.zeros((1, 1)))
        np.testing.assert_allclose(estimate.gradients, [[[wanted]]])
    one = script(1)
    one.rewards, one.limit = one.rewards[:1], 1
    np.testing.assert_allclose(GPOMDP(weights="usual").with_driver(one).episode(np.zeros((1, 1))).gradients, [[[5]]])
    for weights, average in (("usual", 0.081 * 5 + 0.09 * 7 + 0.1 * 11), ("paper", 0.09 * 7 + 0.1 * 11)):
        settings = GPOMDP(weights=weights, average_rate=0.1, bias_correction=False)
        np.testing.assert_allclose(settings.with_driver(script(0)).episode(np.zeros((1, 1))).values, [[average]])


def test_kernels_load_from_the_disk_cache_in_another_process() -> None:
    modules = [f"rl.{name}.advance" for name in ("drivers.finite", "drivers.continuous")]
    modules += [f"rl.estimators.{name}.advance.machine_code" for name in ("gpomdp", "konda_actor_critic")]
    modules += ["envs.arm_kernels.reset", "envs.arm_kernels.step"]
    for name in modules:  # compiled here where they have not been
        pkgutil.resolve_name(name)
    program = f"""import pkgutil
for name in {modules}:
    print(sum(pkgutil.resolve_name(name).stats.cache_hits.values()))"""
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert answer.stdout.split() == ["1"] * len(modules)


# --- the boundary ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "setting", "value"),
    [
        (GPOMDP, "trace_decay", 1.0),
        (GPOMDP, "weights", "unusual"),
        (GPOMDP, "steps", 0),
        (GPOMDP, "average_rate", -0.1),
        (KondaActorCritic, "trace_decay", np.nan),
        (KondaActorCritic, "critic_rate", 0.0),
    ],
)
def test_settings_outside_their_range_are_refused(kind: Any, setting: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"{setting} should be"):
        kind(**{setting: value})


def test_a_policy_of_another_size_is_refused() -> None:
    arm = TwoLinkArm()
    for where, policy, message in (
        (arm, NormalizedGaussianNetwork(*arm.stops, (5, 8), 3), "2 components of the action, .*; found 3"),
        (arm, NormalizedGaussianNetwork([0], [1], (5,), 2), "2 axes of the state, .*; found 1"),
        (MDPS["six channels"], SoftmaxTable(3, 2), "4 states and 3 actions"),
    ):
        with pytest.raises(ValueError, match=f"policy should have {message}"):
            GPOMDP().start(where, policy, streams(1))


@pytest.mark.parametrize(
    ("flaw", "message"),
    [
        ({"step": 1}, "step of a rule should be a function"),
        ({"first": -1}, "first of a rule should be an integer ≥ 0; found -1"),
        ({"span": 1}, "span of a rule should be None or one of its 1 vectors; found 1"),
        ({"constants": [[1.0]]}, r"constants of a rule should be numbers, \(k,\); found shape \(1, 1\)"),
        ({"channels": np.ones((1, 3))}, r"channels of a rule should have shape \(1, 6\); found \(1, 3\)"),
        ({"from_start": np.ones(6)}, "from_start of a rule should be truth values; found dtype float64"),
        (None, "the rule of an estimator should be a Rule; found None"),
    ],
)
def test_a_rule_that_does_not_fit_is_refused(flaw: Any, message: str) -> None:
    class Flawed(SamplingEstimator):
        def rule(self, reported: Any) -> Any:
            return None if flaw is None else replace(Rule(climb, vectors=1), **flaw)

    with pytest.raises(ValueError, match=message):
        Flawed().start(MDPS["six channels"], SoftmaxTable(4, 3), streams(1))


def test_a_subclass_of_gpomdp_goes_by_its_own_rule() -> None:
    class Doubled(GPOMDP):
        def rule(self, reported: Any) -> Rule:
            return Reinforce().rule(reported)

    own, other = (each.start(MDPS["six channels"], SoftmaxTable(4, 3), streams(1)) for each in (Doubled(), Reinforce()))
    np.testing.assert_array_equal(own.episode(np.zeros((1, 12))).gradients, other.episode(np.zeros((1, 12))).gradients)
