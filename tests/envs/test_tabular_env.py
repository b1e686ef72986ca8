"""Finite MDPs as Gymnasium environments."""

import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from envs import FiniteEnvironment, TabularEnv, TabularMDP, ThreeStateMDP, VectorReward, random_mdp


def play(env, seed, steps=50):
    observations, rewards = [env.reset(seed=seed)[0]], []
    actions = np.random.default_rng(0).integers(env.action_space.n, size=steps)
    for action in actions:
        observation, reward, *_ = env.step(action)
        observations.append(observation)
        rewards.append(reward)
    return observations, np.array(rewards), actions


def test_the_gymnasium_checker_has_one_thing_to_say_that_rewards_are_vectors():
    env = gymnasium.make("cpgrl/ThreeState-v0", render_mode="rgb_array").unwrapped
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        check_env(env)
    assert len(said) == 1
    assert "reward returned by `step()` must be a float" in str(said[0].message)


def test_the_registered_environment_is_cut_off_after_a_hundred_steps():
    env = gymnasium.make("cpgrl/ThreeState-v0")
    assert env.reset(seed=0)[0] == 0
    ends = [env.step(0)[2:4] for _ in range(100)]
    assert ends == [(False, False)] * 99 + [(False, True)]


def test_constants_pass_through_gymnasium_make():
    env = gymnasium.make("cpgrl/ThreeState-v0", slip=0.0, start=1).unwrapped
    assert env.reset(seed=0)[0] == 1
    assert [env.step(0)[0] for _ in range(3)] == [2, 0, 1]


def test_conventions_of_mo_gymnasium_hold():
    env = TabularEnv(ThreeStateMDP())
    assert env.reward_dim == env.reward_channels == 4
    assert env.reward_space.low.tolist() == [-1, -1, -1, -1]
    assert env.reward_space.high.tolist() == [2, 1, 1, 1]
    observations, rewards, _ = play(env, seed=1)
    assert all(env.observation_space.contains(observation) for observation in observations)
    assert all(env.reward_space.contains(reward) for reward in rewards)
    assert rewards.dtype == np.float64


def test_rewards_belong_to_the_state_that_is_left():
    mdp = random_mdp(np.random.default_rng(0), 4, 3, 2)
    observations, rewards, actions = play(TabularEnv(mdp), seed=3)
    assert rewards.tolist() == mdp.rewards[:, observations[:-1], actions].T.tolist()


def test_rewards_are_fresh_arrays():
    env = TabularEnv(ThreeStateMDP())
    env.reset(seed=0)
    env.step(0)[1][:] = 99
    assert env.mdp.rewards.max() == 2


def test_seeds_reproduce_and_differ():
    env, other = TabularEnv(ThreeStateMDP()), TabularEnv(ThreeStateMDP())
    assert play(env, seed=7)[0] == play(other, seed=7)[0] == play(env, seed=7)[0]
    assert play(env, seed=7)[0] != play(env, seed=8)[0]


def test_transitions_follow_their_probabilities():
    mdp = random_mdp(np.random.default_rng(1), 3, 2, 1)
    env = TabularEnv(mdp)
    observations, _, actions = play(env, seed=5, steps=20_000)
    counts = np.zeros((3, 2, 3))
    np.add.at(counts, (observations[:-1], actions, observations[1:]), 1)
    n = counts.sum(axis=2, keepdims=True)
    standard_error = np.sqrt(mdp.transitions * (1 - mdp.transitions) / n)
    assert (np.abs(counts / n - mdp.transitions) <= 5 * standard_error).all()


def test_impossible_transitions_never_happen():
    # The zeros stand first, in the middle and last, where a careless inverse of the distribution would hit them.
    mdp = TabularMDP([[[0, 1 / 3, 0, 2 / 3, 0]]] * 5, np.zeros((1, 5, 1)))
    env = TabularEnv(mdp)
    observations, _, _ = play(env, seed=0, steps=2000)
    assert set(observations[1:]) == {1, 3}

    class Extreme(np.random.Generator):
        draws = iter([0.0, np.nextafter(1, 0)])

        def random(self):
            return next(self.draws)

    env.np_random = Extreme(np.random.PCG64(0))
    assert [env.step(0)[0] for _ in range(2)] == [1, 3]


@pytest.mark.parametrize("action", [3, -1, 1.0, "a₁", None, np.nan, [0]])
def test_an_action_that_is_none_is_refused(action):
    env = TabularEnv(ThreeStateMDP())
    env.reset(seed=0)
    with pytest.raises(ValueError, match="action should be an integer in 0 … 2"):
        env.step(action)


def test_stepping_needs_a_reset_first():
    env = TabularEnv(ThreeStateMDP(), render_mode="rgb_array")
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset should be called"):
        env.step(0)
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset should be called"):
        env.render()


@pytest.mark.parametrize("states", [1, 3, 40])
def test_the_picture_shows_where_the_agent_is(states):
    mdp = random_mdp(np.random.default_rng(2), states, 2, 8)
    env = TabularEnv(mdp, render_mode="rgb_array")
    env.reset(seed=0)
    pictures = [env.render()]
    for action in (0, 1):
        env.step(action)
        pictures.append(env.render())
    assert all(picture.shape == (400, 400, 3) and picture.dtype == np.uint8 for picture in pictures)
    assert all(picture.std() > 5 for picture in pictures)
    assert (pictures[1] != pictures[2]).any()


def test_pictures_must_be_asked_for():
    env = TabularEnv(ThreeStateMDP())
    env.reset(seed=0)
    with pytest.raises(ValueError, match="render_mode should be 'rgb_array' to draw"):
        env.render()
    with pytest.raises(ValueError, match="render_mode should be None or 'rgb_array'; found 'human'"):
        TabularEnv(ThreeStateMDP(), render_mode="human")


def test_an_environment_offers_the_compiled_path_and_survives_pickling():
    env = pickle.loads(pickle.dumps(TabularEnv(ThreeStateMDP(), render_mode="rgb_array")))
    assert isinstance(env, VectorReward)
    assert isinstance(env, FiniteEnvironment)
    assert env.finite_kernel().rewards.tolist() == ThreeStateMDP().rewards.tolist()
    assert play(env, seed=2)[0] == play(TabularEnv(ThreeStateMDP()), seed=2)[0]
