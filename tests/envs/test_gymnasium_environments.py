"""Finite MDPs and the arm as Gymnasium environments: what both keep, then what is each one's own."""

import itertools
import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from envs import (
    ArmObject,
    TabularEnv,
    TabularMDP,
    ThreeStateMDP,
    TwoLinkArm,
    TwoLinkArmEnv,
    random_mdp,
)
from rl.testing import check_constrained_env

MAKERS = {"chain": lambda **more: TabularEnv(ThreeStateMDP(), **more), "arm": TwoLinkArmEnv}
REGISTERED = {"chain": "cpgrl/ThreeState-v0", "arm": "cpgrl/TwoLinkArm-v0"}
SAID = {"chain": ["must be a float"], "arm": ["symmetric and normalized space", "must be a float"]}
both = pytest.mark.parametrize("name", MAKERS)
needs_reset = pytest.raises(gymnasium.error.ResetNeeded, match=r"reset should be called before (step|render)")


def play(env, seed, steps=30):
    """Observations, rewards and actions of an episode."""
    env.action_space.seed(0)
    observations, rewards, actions = [env.reset(seed=seed)[0]], [], [env.action_space.sample() for _ in range(steps)]
    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action)
        observations.append(observation)
        rewards.append(reward)
        if terminated or truncated:
            break
    return np.array(observations), np.array(rewards), np.array(actions)


def face(name, **constants):
    """An arm one step of action 0 away from touching the object of this name."""
    env = TwoLinkArmEnv(**constants)
    x, y = next(thing.position for thing in env.arm.objects if thing.name == name)
    second = np.arccos((x**2 + y**2 - 2) / 2)
    env.reset(seed=0, options={"angles": (np.arctan2(y, x) - second / 2, second)})
    return env


@both
def test_gymnasiums_checker_complains_of_nothing_but_vectors_and_units(name):
    """It would like actions in [−1, 1], of Gymnasium's own Pendulum too; ours are rad/s, as training has them."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        check_env(gymnasium.make(REGISTERED[name], render_mode="rgb_array").unwrapped)
    assert len(said) == len(SAID[name])
    for warning, words in zip(said, SAID[name], strict=True):
        assert words in str(warning.message)


@both
def test_our_own_checker_is_content(name):
    """Spaces, channels, seeds, fresh arrays, and the kernels against `step`."""
    check_constrained_env(MAKERS[name](), steps=200)


@both
def test_an_environment_survives_pickling(name):
    env = pickle.loads(pickle.dumps(MAKERS[name](render_mode="rgb_array")))
    for one, other in zip(play(env, seed=2), play(MAKERS[name](), seed=2), strict=True):
        assert one.tolist() == other.tolist()
    assert play(env, seed=2)[0].tolist() != play(env, seed=3)[0].tolist()


@both
def test_pictures_must_be_asked_for_and_nothing_is_there_before_a_reset(name):
    env = MAKERS[name](render_mode="rgb_array")
    with needs_reset:
        env.render()
    with needs_reset:
        env.step(env.action_space.sample())
    env = MAKERS[name]()
    env.reset(seed=0)
    with pytest.raises(ValueError, match="render_mode should be 'rgb_array' to draw"):
        env.render()
    with pytest.raises(ValueError, match="render_mode should be None or 'rgb_array'; found 'human'"):
        MAKERS[name](render_mode="human")


def test_an_action_that_is_none_is_refused_and_moves_nothing():
    for name, action, message in (
        ("chain", 1.0, "action should be an integer in 0 … 2"),
        ("arm", [np.nan, 0], "action should have no NaN"),
        ("arm", [0, 0, 0], r"action should have shape \(2,\); found \(3,\)"),
    ):
        env = MAKERS[name]()
        start, _ = env.reset(seed=0)
        with pytest.raises(ValueError, match=message):
            env.step(action)
    assert env.step(np.zeros(2))[0].tolist() == start.tolist()


def test_time_runs_out_in_every_episode_anew():
    for name, constants, steps, still in (("chain", {}, 100, 0), ("arm", {"max_steps": 5}, 5, np.zeros(2))):
        env = gymnasium.make(REGISTERED[name], **constants)
        for _ in range(2):
            env.reset(seed=0)
            assert [env.step(still)[2:4] for _ in range(steps)] == [(False, False)] * (steps - 1) + [(False, True)]


@both
def test_a_picture_shows_what_a_step_changed(name):
    env = MAKERS[name](render_mode="rgb_array")
    env.reset(seed=0)
    pictures = [env.render()]
    for action in (0, 1) if name == "chain" else (np.ones(2), -np.ones(2)):
        env.step(action)
        pictures.append(env.render())
    assert all((picture.shape, picture.dtype) == ((400, 400, 3), np.uint8) for picture in pictures)
    assert all((before[60:] != after[60:]).any() for before, after in itertools.pairwise(pictures))  # below the caption


def test_any_chain_and_any_arm_can_be_drawn():
    things = tuple(ArmObject(f"thing {k}", (k / 4, 1.9), k) for k in range(7))
    for env in (
        TabularEnv(random_mdp(np.random.default_rng(2), 40, 2, 8), render_mode="rgb_array"),
        TabularEnv(random_mdp(np.random.default_rng(2), 1, 2, 1), render_mode="rgb_array"),
        TwoLinkArmEnv(objects=things, link_lengths=(2.0, 0.5), render_mode="rgb_array"),
    ):
        env.reset(seed=0)
        assert env.render().std() > 5


# Finite MDPs


def test_impossible_transitions_never_happen():
    """The zeros stand first, in the middle and last, where a careless inverse of the distribution would hit them."""

    class Extreme(np.random.Generator):
        draws = iter([0.0, np.nextafter(1, 0)])

        def random(self):
            return next(self.draws)

    env = TabularEnv(TabularMDP([[[0, 1 / 3, 0, 2 / 3, 0]]] * 5, np.zeros((1, 5, 1))))
    env.reset(seed=0)
    env.np_random = Extreme(np.random.PCG64(0))
    assert [env.step(0)[0] for _ in range(2)] == [1, 3]


def test_constants_pass_through_gymnasium_make():
    env = gymnasium.make("cpgrl/ThreeState-v0", slip=0.0, start=1).unwrapped
    assert env.reset(seed=0)[0] == 1
    assert [env.step(0)[0] for _ in range(3)] == [2, 0, 1]
    arm = TwoLinkArm(dt=0.1)
    assert gymnasium.make("cpgrl/TwoLinkArm-v0", dt=0.1).unwrapped.arm == TwoLinkArmEnv(arm).arm == arm
    with pytest.raises(ValueError, match=r"constants should come with the arm or by name, not both; found \['dt'\]"):
        TwoLinkArmEnv(arm, dt=0.2)


# The arm


def test_a_touch_terminates_and_is_named_on_the_last_step_too():
    env = face("square", max_steps=1)
    _, reward, terminated, truncated, info = env.step(np.zeros(2))
    assert (terminated, truncated) == (True, False)
    assert info == {"touched": "square", "event": 3}
    assert reward[2] == 1
    with pytest.raises(gymnasium.error.ResetNeeded, match="found an episode that has ended"):
        env.step(np.zeros(2))
    assert env.reset(seed=0)[1] == {"touched": "none", "event": 0}


def test_a_start_can_be_given():
    env = TwoLinkArmEnv()
    assert env.reset(options={"angles": [0.0, 2.5]})[0].tolist() == [0.0, 2.5]
    for options, message in [
        ({"angles": [-0.1, 2.5]}, "angles should be .* between the stops"),
        ({"angles": [1.0]}, "angles should be .* between the stops"),
        ({"angle": [1.0, 1.0]}, r"options should hold 'angles' or nothing; found \['angle'\]"),
    ]:
        with pytest.raises(ValueError, match=message):
            env.reset(options=options)
