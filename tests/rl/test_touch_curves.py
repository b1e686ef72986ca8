"""Windows and averages of touch curves; what no policy of the arm can exceed."""

import dataclasses

import numpy as np
import pytest

from envs import TwoLinkArm
from rl.experiments.arm.bound import greatest_average_r3
from rl.experiments.arm.curves import TouchCurves

ARM = TwoLinkArm()


def curves(episodes, sizes=None, runs=2, seed=0):
    rng = np.random.default_rng(seed)
    episodes = np.asarray(episodes)
    sizes = np.diff(episodes, prepend=0) if sizes is None else np.asarray(sizes)
    touches = np.array([[rng.multinomial(size, np.full(5, 0.2)) for size in sizes] for _ in range(runs)])
    shape = (runs, len(episodes))
    return TouchCurves(ARM, episodes, sizes, touches, rng.uniform(0, 0.5, shape), rng.uniform(1, 50, shape))


LONG = curves(range(100, 10_001, 100))


def test_early_and_late_are_the_first_500_and_the_last_1000_episodes():
    np.testing.assert_array_equal(LONG.early().episodes, [100, 200, 300, 400, 500])
    np.testing.assert_array_equal(LONG.late().episodes, range(9100, 10_001, 100))
    np.testing.assert_array_equal(LONG.late().touches, LONG.touches[:, -10:])


@pytest.mark.parametrize(
    ("episodes", "early", "late", "since"),
    [
        ([100, 200, 300], [100], [300], [300]),
        (range(100, 2001, 100), [100, 200, 300, 400, 500], [1900, 2000], range(1100, 2001, 100)),
        ([30], [30], [30], [30]),
        ([100, 200, 250], [100], [250], [250]),  # the last block is shorter
    ],
)
def test_a_shorter_training_has_shorter_windows_but_never_none(episodes, early, late, since):
    learned = curves(episodes)
    np.testing.assert_array_equal(learned.early().episodes, early)
    np.testing.assert_array_equal(learned.late().episodes, late)
    np.testing.assert_array_equal(learned.within(1000, 2000).episodes, since)


def test_rates_are_per_hundred_episodes_and_sum_to_a_hundred():
    learned = curves([100, 200, 250])
    np.testing.assert_allclose(learned.per_hundred().sum(axis=2), 100)
    np.testing.assert_allclose(learned.rates().sum(axis=1), 100)
    np.testing.assert_allclose(learned.rates(), learned.touches.sum(axis=1) / 2.5)
    np.testing.assert_allclose(learned.mean_rates()["square"], learned.touches[:, :, 2].sum(axis=1).mean() / 2.5)
    assert learned.outcomes == ("circle", "star", "square", "triangle", "none")


def test_averages_weigh_blocks_by_their_steps():
    learned = dataclasses.replace(
        curves([10, 40], runs=1), violation=np.array([[1.0, 0.0]]), length=np.array([[3.0, 2.0]])
    )
    assert learned.outside() == pytest.approx(30 / 90)


def test_r3_is_square_less_star_per_step_or_per_episode():
    learned = curves([10, 40])
    earned = learned.touches[:, :, 2].sum(axis=1) - learned.touches[:, :, 1].sum(axis=1)
    np.testing.assert_allclose(learned.average_r3("episode"), earned / 40)
    np.testing.assert_allclose(learned.average_r3("step"), earned / (learned.length @ np.array([10, 30])))


def least_time_average(arm: TwoLinkArm, episodes: int) -> float:
    """ρ³ of going straight for the square at full speed, which a bound must allow."""
    places = np.stack(np.meshgrid(*np.linspace(*arm.stops, 300).T, indexing="ij"), axis=-1).reshape(-1, 2)
    touching = places[arm.touched(arm.forward_kinematics(places)) == 3]
    rng, earned, steps = np.random.default_rng(0), 0, 0
    low, high = np.array(arm.box).T
    for _ in range(episodes):
        angles, event = rng.uniform(low, high), 0
        while event == 0:
            goal = touching[np.abs(touching - angles).max(axis=1).argmin()]
            angles = angles + np.clip(goal - angles, -arm.dt * arm.max_speed, arm.dt * arm.max_speed)
            event, steps = int(arm.touched(arm.forward_kinematics(angles))), steps + 1
        earned += {2: -1, 3: 1}.get(event, 0)
    return earned / steps


def test_no_policy_reaches_half_a_square_per_step_and_the_bound_is_not_loose():
    bound = greatest_average_r3(ARM)
    reached = least_time_average(ARM, 300)
    assert 0.6 * bound < reached < bound < 0.4


def test_the_bound_follows_speed_and_rewards():
    assert greatest_average_r3(TwoLinkArm(max_speed=1000.0)) == pytest.approx(1.0)  # any touch within one step
    assert greatest_average_r3(TwoLinkArm(max_speed=1.5)) < 0.6 * greatest_average_r3(ARM)
    doubled = [dataclasses.replace(thing, reward=2 * thing.reward) for thing in ARM.objects]
    assert greatest_average_r3(TwoLinkArm(objects=tuple(doubled))) == pytest.approx(2 * greatest_average_r3(ARM))
