"""What somebody's own code says is trained on: kernels stand only for the class that declares them."""

# ruff: noqa: ARG002 - stand-ins take what they ignore

from functools import cached_property
from typing import Any
from unittest import mock

import gymnasium
import numpy as np
import pytest

from envs import FiniteKernel, TabularEnv, TabularMDP, ThreeStateEnv, ThreeStateMDP, TwoLinkArm, TwoLinkArmEnv
from envs.interface import continuous_kernels_of, finite_kernel_of
from rl import GPOMDP, ExactGradient, NormalizedGaussianNetwork, SoftmaxTable
from rl.drivers import PythonDriver, driver_for

from .stand_ins import Foreign, estimate_of, streams

ESTIMATOR = GPOMDP(steps=7)
ONES = np.ones((2, 3, 3))  # every step yields 1 in both channels
SEVEN = [[7.0, 7.0]]
MINUS_SEVEN = [[-7.0, -7.0]]


def rewards_of(environment: Any, policy: Any = None) -> list[list[float]]:
    """Each channel's sum over one episode of one run."""
    return estimate_of(environment, ESTIMATOR, policy or SoftmaxTable(3, 3))[1].rewards.tolist()


def turned(step: Any) -> Any:
    """A step whose rewards have the other sign."""

    def other(self: Any, action: Any) -> Any:
        observation, reward, *rest = step(self, action)
        return (observation, -reward, *rest)

    return other


class First(SoftmaxTable):
    """Takes the first action whatever θ is."""

    def sample(self, observation: Any, rng: Any) -> int:
        return 0


class OwnStep(ThreeStateEnv):
    step = turned(ThreeStateEnv.step)


class Declares(TabularEnv):
    """Kernels declared below the step that they restate, and beside it another branch of the same family."""

    def finite_kernel(self) -> FiniteKernel:
        return super().finite_kernel()


class Other(TabularEnv):
    step = turned(TabularEnv.step)


class Diamond(Declares, Other):
    """`step` is Other's, which stands behind Declares in the order of resolution."""


class Lender:
    """A proxy that lends everything but its step; on Python 3.11 it looks like a FiniteEnvironment."""

    def __init__(self, environment: Any) -> None:
        self.inner = environment

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    step = turned(lambda self, action: self.inner.step(action))


class Wrapped(gymnasium.Wrapper):  # type: ignore[type-arg]
    step = turned(gymnasium.Wrapper.step)


class Helped(gymnasium.Env):  # type: ignore[type-arg]
    """Somebody's environment, whose step asks a method for the reward."""

    reward_channels = 2
    observation_space, action_space = gymnasium.spaces.Discrete(3), gymnasium.spaces.Discrete(3)

    def finite_kernel(self) -> FiniteKernel:
        return TabularMDP(np.full((3, 3, 3), 1 / 3), ONES).finite_kernel()

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        return 0, {}

    def step(self, action: Any) -> Any:
        return int(self.np_random.integers(3)), self.reward(action), False, False, {}

    def reward(self, action: Any) -> np.ndarray:
        return np.ones(2)


class OwnReward(Helped):
    def reward(self, action: Any) -> np.ndarray:
        return -np.ones(2)


def patched() -> ThreeStateEnv:
    environment = ThreeStateEnv(rewards=ONES)
    environment.step = turned(ThreeStateEnv.step).__get__(environment)  # type: ignore[method-assign]
    return environment


OTHERS: dict[str, Any] = {
    "a subclass": lambda: OwnStep(rewards=ONES),
    "a diamond": lambda: Diamond(ThreeStateMDP(rewards=ONES)),
    "a patched instance": patched,
    "a lending proxy": lambda: Lender(ThreeStateEnv(rewards=ONES)),
    "a wrapper": lambda: Wrapped(ThreeStateEnv(rewards=ONES)),
    "a helper of step": OwnReward,
}


@pytest.mark.parametrize("who", OTHERS)
def test_rewards_are_those_of_the_step_that_is_there(who: str) -> None:
    environment = OTHERS[who]()
    assert rewards_of(environment) == MINUS_SEVEN
    assert finite_kernel_of(environment) is None


def test_code_patched_into_our_own_classes_is_trained_on() -> None:
    with mock.patch.object(TabularEnv, "step", turned(TabularEnv.step)):
        assert rewards_of(ThreeStateEnv(rewards=ONES)) == MINUS_SEVEN
    with mock.patch.object(TwoLinkArmEnv, "step", OwnArmStep.step):
        assert continuous_kernels_of(TwoLinkArmEnv()) is None
    with (
        mock.patch.object(TwoLinkArm, "touched", lambda _self, points: np.zeros(len(points))),
        pytest.raises(ValueError, match="since it has its own touched"),
    ):
        TwoLinkArmEnv()
    by_action = np.broadcast_to([1.0, 2.0, 3.0], (2, 3, 3))
    with mock.patch.object(SoftmaxTable, "sample", First.sample):
        assert rewards_of(TabularEnv(ThreeStateMDP(rewards=by_action))) == SEVEN
    assert rewards_of(ThreeStateEnv(rewards=ONES)) == SEVEN  # put back, compiled again
    assert finite_kernel_of(ThreeStateEnv()) is not None


class Unchanged(ThreeStateEnv):
    """Methods and data of its own, but no other dynamics."""

    def render(self) -> Any:
        return None

    @cached_property
    def once(self) -> int:
        return 1


class Vouches(OwnStep):
    """Its own step, and a kernel that says the same."""

    def finite_kernel(self) -> FiniteKernel:
        kernel = super().finite_kernel()
        return FiniteKernel(kernel.transition_cumulative, -kernel.rewards, kernel.start)


def test_who_changes_nothing_or_declares_a_kernel_runs_compiled() -> None:
    unchanged = Unchanged(rewards=ONES)
    assert unchanged.once == 1  # a cached value in the instance is no override
    for environment, rewards in (
        (unchanged, SEVEN),
        (Vouches(rewards=ONES), MINUS_SEVEN),
        (Declares(ThreeStateMDP(rewards=ONES)), SEVEN),
        (ThreeStateMDP(rewards=ONES), SEVEN),
        (Helped(), SEVEN),
    ):
        assert rewards_of(environment) == rewards
        assert not isinstance(driver_for(environment, SoftmaxTable(3, 3), streams(), 7), PythonDriver)


# --- the arm -----------------------------------------------------------------------------------------------------


def network() -> NormalizedGaussianNetwork:
    return NormalizedGaussianNetwork(*TwoLinkArm().stops, (5, 8), 2)


class OwnArmStep(TwoLinkArmEnv):
    def step(self, action: Any) -> Any:
        observation, _, *rest = super().step(action)
        return (observation, np.array([-1.0, -2.0, 3.0]), *rest)


class NearMiss(TwoLinkArm):
    def touched(self, points: Any) -> Any:
        return np.zeros_like(super().touched(points))


def test_an_arm_is_trained_by_its_own_step_or_refused() -> None:
    message = "NearMiss should declare its own continuous_kernels, or have reset and step, since it has its own touched"
    for refuse in (lambda: rewards_of(NearMiss(), network()), lambda: TwoLinkArmEnv(NearMiss())):
        with pytest.raises(ValueError, match=message):
            refuse()
    environment = OwnArmStep(touch_radius=1e-6)
    assert rewards_of(environment, network()) == [[-7.0, -14.0, 21.0]]
    assert continuous_kernels_of(environment) is None
    for compiled in (TwoLinkArm(), TwoLinkArmEnv()):
        assert not isinstance(driver_for(compiled, network(), streams(), 7), PythonDriver)


# --- finite MDPs -------------------------------------------------------------------------------------------------


class Halting(ThreeStateMDP):
    """A finite MDP that somebody made an environment of."""

    def reset(self, *, seed: int) -> Any:
        return 0, {}

    def step(self, action: int) -> Any:
        return 0, -np.ones(2), False, False, {}


class Lame(ThreeStateMDP):
    def step(self, action: int) -> Any:
        return 0, -np.ones(2), False, False, {}


def test_an_mdp_with_a_step_is_trained_by_it_or_refused() -> None:
    assert rewards_of(Halting(rewards=ONES)) == MINUS_SEVEN
    with pytest.raises(ValueError, match="Lame should declare its own finite_kernel, or have reset and step"):
        rewards_of(Lame())
    with pytest.raises(ValueError, match="mdp should be a TabularMDP without a step of its own; found Halting"):
        TabularEnv(Halting())


@pytest.mark.parametrize(
    ("mdp", "policy", "message"),
    [
        (Halting(), SoftmaxTable, "should declare its own average_rewards and policy_gradients"),
        (Lame(), SoftmaxTable, "should declare its own average_rewards and policy_gradients"),
        (ThreeStateMDP(), First, "policy should be a SoftmaxTable with no code of its own; found First"),
    ],
)
def test_exact_answers_are_refused_where_the_dynamics_are_somebodys_own(mdp: Any, policy: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ExactGradient().start(mdp, policy(3, 3), streams())


# --- policies ----------------------------------------------------------------------------------------------------


class Upright(NormalizedGaussianNetwork):
    """A network of another constructor, whose arm stands still."""

    def __init__(self) -> None:
        super().__init__(*TwoLinkArm().stops, (5, 8), 2)

    def sample(self, observation: Any, rng: Any) -> np.ndarray:
        return np.zeros(2)


def test_a_policys_own_code_acts_and_survives_another_theta() -> None:
    by_action = np.broadcast_to([1.0, 2.0, 3.0], (2, 3, 3))
    assert rewards_of(TabularEnv(ThreeStateMDP(rewards=by_action)), First(3, 3)) == SEVEN
    with pytest.raises(ValueError, match=r"a finite MDP .* no subclass with its own code; found ThreeStateMDP"):
        rewards_of(ThreeStateMDP(), First(3, 3))
    still = rewards_of(TwoLinkArmEnv(touch_radius=1e-6), Upright())
    assert still[0][1] == 0  # an arm at rest does not leave the box
    for policy in (First(3, 3), Upright()):
        other = policy.with_parameters(np.arange(float(len(policy.parameters))))
        assert type(other) is type(policy)
        assert other.parameters[-1] == len(policy.parameters) - 1


def test_what_a_policy_caches_is_computed_anew_at_another_theta() -> None:
    class Caching(SoftmaxTable):
        @cached_property
        def table(self) -> np.ndarray:
            return self.probabilities()

    policy = Caching(2, 2)
    assert policy.table.tolist() == [[0.5, 0.5]] * 2
    assert policy.with_parameters([0.0, np.log(3), 0.0, 0.0]).table[0].tolist() == pytest.approx([0.25, 0.75])


def test_a_policy_of_ones_own_may_read_other_observations() -> None:
    class Halves(SoftmaxTable):
        def sample(self, observation: Any, rng: Any) -> int:
            return super().sample(int(observation[0] > 0), rng)

        def score(self, observation: Any, action: Any) -> np.ndarray:
            return super().score(int(observation[0] > 0), action)

    assert rewards_of(Foreign(), Halves(2, 2)) == SEVEN
