"""The two-link arm as a Gymnasium environment."""

import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from envs import ArmObject, ContinuousEnvironment, TwoLinkArm, TwoLinkArmEnv, VectorReward


def play(env, seed, steps=30):
    observations, rewards = [env.reset(seed=seed)[0].tolist()], []
    for action in np.random.default_rng(0).normal(size=(steps, 2)):
        observation, reward, terminated, truncated, _ = env.step(action)
        observations.append(observation.tolist())
        rewards.append(reward.tolist())
        if terminated or truncated:
            break
    return observations, rewards


def facing(name, **constants):
    """An environment one step of action 0 away from touching the object `name`."""
    env = TwoLinkArmEnv(**constants)
    x, y = next(thing.position for thing in env.arm.objects if thing.name == name)
    second = np.arccos((x**2 + y**2 - 2) / 2)
    env.reset(seed=0, options={"angles": (np.arctan2(y, x) - second / 2, second)})
    return env


def test_the_gymnasium_checker_complains_of_nothing_but_vectors_and_units():
    # Actions are rad/s up to 3, as compiled training has them; the checker would like [−1, 1], of Gymnasium's own
    # Pendulum too.
    env = gymnasium.make("cpgrl/TwoLinkArm-v0", render_mode="rgb_array").unwrapped
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        check_env(env)
    units, vectors = (str(warning.message) for warning in said)
    assert "we recommend using a symmetric and normalized space" in units
    assert "reward returned by `step()` must be a float" in vectors


def test_conventions_of_mo_gymnasium_hold():
    env = TwoLinkArmEnv()
    assert env.reward_dim == env.reward_channels == 3
    assert env.reward_space.low.tolist() == [0, -1, -1]
    assert env.reward_space.high.tolist() == [1, 0, 1]
    assert env.action_space == gymnasium.spaces.Box(-3, 3, (2,), np.float64)
    assert env.observation_space == gymnasium.spaces.Box(*env.arm.stops, dtype=np.float64)
    for seed in range(20):
        observations, rewards = play(env, seed)
        assert all(env.observation_space.contains(np.array(observation)) for observation in observations)
        assert all(env.reward_space.contains(np.array(reward)) for reward in rewards)


def test_prizes_of_one_sign_still_allow_zero():
    env = TwoLinkArmEnv(objects=(ArmObject("it", (0, 1), 4.0),))
    assert (env.reward_space.low[2], env.reward_space.high[2]) == (0, 4)


def test_steps_are_the_ones_of_the_compiled_kernel():
    env = TwoLinkArmEnv()
    kernels = env.continuous_kernels()
    observations, rewards = play(env, seed=3)
    state, reward = np.array(observations[0]), np.empty(3)
    actions = np.random.default_rng(0).normal(size=(30, 2))
    for action, observation, given in zip(actions, observations[1:], rewards, strict=False):
        kernels.step(kernels.constants, state, action, np.zeros(4, np.uint64), reward)
        assert state.tolist() == observation
        assert reward.tolist() == given


@pytest.mark.parametrize(
    ("name", "event", "prize"), [("circle", 1, 0), ("star", 2, -1), ("square", 3, 1), ("triangle", 4, 0)]
)
def test_a_touch_terminates_and_is_named(name, event, prize):
    _, reward, terminated, truncated, info = facing(name).step(np.zeros(2))
    assert (terminated, truncated) == (True, False)
    assert info == {"touched": name, "event": event}
    assert reward[2] == prize


def test_while_nothing_is_touched_the_info_says_none():
    env = TwoLinkArmEnv()
    assert env.reset(seed=0)[1] == {"touched": "none", "event": 0}
    assert env.step(np.zeros(2))[2:] == (False, False, {"touched": "none", "event": 0})


@pytest.mark.parametrize("maker", [TwoLinkArmEnv, lambda **k: gymnasium.make("cpgrl/TwoLinkArm-v0", **k)])
def test_time_runs_out_after_max_steps(maker):
    env = maker(max_steps=5)
    for _ in range(2):  # in every episode anew
        env.reset(seed=0)
        assert [env.step(np.zeros(2))[2:4] for _ in range(5)] == [(False, False)] * 4 + [(False, True)]


def test_time_runs_out_after_a_thousand_steps_as_in_the_paper():
    env = gymnasium.make("cpgrl/TwoLinkArm-v0")
    env.reset(seed=0)
    ends = [env.step(np.zeros(2))[3] for _ in range(1000)]
    assert ends.index(True) == 999


def test_a_touch_on_the_last_step_is_no_truncation():
    assert facing("square", max_steps=1).step(np.zeros(2))[2:4] == (True, False)


def test_actions_out_of_range_are_clipped():
    env = TwoLinkArmEnv()
    start = {"angles": (1.0, 1.2)}
    env.reset(options=start)
    far = env.step([100, -np.inf])[0]
    env.reset(options=start)
    assert far.tolist() == env.step([3, -3])[0].tolist()
    np.testing.assert_allclose(far, [1.15, 1.05])


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ([np.nan, 0], "action should have no NaN"),
        ([0, 0, 0], r"action should have shape \(2,\); found \(3,\)"),
        (0.5, r"action should have shape \(2,\); found \(\)"),
        (None, "action should be an array of real numbers"),
        (["left", "up"], "action should be an array of real numbers"),
    ],
)
def test_an_action_that_is_none_is_refused_and_moves_nothing(action, message):
    env = TwoLinkArmEnv()
    start, _ = env.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        env.step(action)
    assert env.step(np.zeros(2))[0].tolist() == start.tolist()


def test_seeds_reproduce_and_differ():
    env, other = TwoLinkArmEnv(), TwoLinkArmEnv()
    assert play(env, seed=7) == play(other, seed=7) == play(env, seed=7)
    assert play(env, seed=7) != play(env, seed=8)
    env.reset(seed=7)
    first, second = env.reset()[0], env.reset()[0]
    other.reset(seed=7)
    assert other.reset()[0].tolist() == first.tolist() != second.tolist()


def test_starts_lie_in_the_box_and_touch_nothing():
    env = TwoLinkArmEnv()
    env.reset(seed=0)
    states = np.array([env.reset()[0] for _ in range(2000)])
    low, high = np.array(env.arm.box).T
    assert ((states >= low) & (states <= high)).all()
    assert not env.arm.touched(env.arm.forward_kinematics(states)).any()
    assert np.ptp(states, axis=0) == pytest.approx(high - low, rel=0.02)


def test_a_start_can_be_given():
    env = TwoLinkArmEnv()
    assert env.reset(options={"angles": [0.0, 2.5]})[0].tolist() == [0.0, 2.5]
    for options, message in [
        ({"angles": [-0.1, 2.5]}, "angles should be .* between the stops"),
        ({"angles": [1.0]}, "angles should be .* between the stops"),
        ({"angles": [1.0, np.nan]}, "angles should have no NaN"),
        ({"angle": [1.0, 1.0]}, r"options should hold 'angles' or nothing; found \['angle'\]"),
    ]:
        with pytest.raises(ValueError, match=message):
            env.reset(options=options)


def test_what_is_handed_out_is_a_copy():
    env = TwoLinkArmEnv()
    start = env.reset(seed=0)[0]
    kept = start.copy()
    start[:] = 99
    observation, reward, *_ = env.step(np.zeros(2))
    assert observation.tolist() == kept.tolist()
    observation[:], reward[:] = 99, 99
    assert env.step(np.zeros(2))[0].tolist() == kept.tolist()


def test_stepping_needs_a_reset_before_and_after_an_episode():
    env = TwoLinkArmEnv(render_mode="rgb_array")
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset should be called before step; found no state"):
        env.step(np.zeros(2))
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset should be called before render"):
        env.render()
    env = facing("star")
    env.step(np.zeros(2))
    with pytest.raises(gymnasium.error.ResetNeeded, match="found an episode that has ended"):
        env.step(np.zeros(2))


def test_constants_come_with_the_arm_or_by_name():
    arm = TwoLinkArm(dt=0.1)
    assert TwoLinkArmEnv(arm).arm == TwoLinkArmEnv(dt=0.1).arm == arm
    assert gymnasium.make("cpgrl/TwoLinkArm-v0", dt=0.1).unwrapped.arm == arm
    with pytest.raises(ValueError, match=r"constants should come with the arm or by name, not both; found \['dt'\]"):
        TwoLinkArmEnv(arm, dt=0.2)
    with pytest.raises(ValueError, match="dt should be a number"):
        TwoLinkArmEnv(dt=0)


def test_the_picture_shows_arm_and_objects():
    env = facing("square", render_mode="rgb_array")
    before = env.render()
    assert (before.shape, before.dtype) == ((400, 400, 3), np.uint8)
    env.step(np.zeros(2))
    assert (before != env.render()).any()  # the caption names the touch
    env.reset(options={"angles": (0.2, 0.5)})
    moved = env.render()
    assert (before[60:] != moved[60:]).any(axis=-1).sum() > 1000  # the arm, below the caption
    for colour in [(47, 127, 196), (200, 69, 47), (60, 154, 95), (242, 177, 52), (38, 50, 59)]:
        assert (moved == colour).all(axis=-1).sum() > 20


def test_any_objects_can_be_drawn():
    things = tuple(ArmObject(f"thing {k}", (k / 4, 1.9), k) for k in range(7))
    env = TwoLinkArmEnv(objects=things, link_lengths=(2.0, 0.5), render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().std() > 5


def test_pictures_must_be_asked_for():
    env = TwoLinkArmEnv()
    env.reset(seed=0)
    with pytest.raises(ValueError, match="render_mode should be 'rgb_array' to draw"):
        env.render()
    with pytest.raises(ValueError, match="render_mode should be None or 'rgb_array'; found 'human'"):
        TwoLinkArmEnv(render_mode="human")


def test_an_environment_offers_the_compiled_path_and_survives_pickling():
    env = pickle.loads(pickle.dumps(TwoLinkArmEnv(render_mode="rgb_array")))
    assert isinstance(env, VectorReward)
    assert isinstance(env, ContinuousEnvironment)
    assert play(env, seed=2) == play(TwoLinkArmEnv(), seed=2)
