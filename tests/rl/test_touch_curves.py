"""Windows and averages of touch curves; what no policy of the arm can exceed."""

import dataclasses

import numpy as np
import pytest

from envs import TwoLinkArm
from rl.experiments.arm.bound import greatest_average_r3
from rl.experiments.arm.curves import TouchCurves

ARM = TwoLinkArm()


def curves(episodes, runs=2):
    rng, episodes = np.random.default_rng(0), np.asarray(episodes)
    sizes = np.diff(episodes, prepend=0)
    touches = np.array([[rng.multinomial(size, np.full(5, 0.2)) for size in sizes] for _ in range(runs)])
    shape = (runs, len(episodes))
    return TouchCurves(ARM, episodes, sizes, touches, rng.uniform(0, 0.5, shape), rng.uniform(1, 50, shape))


@pytest.mark.parametrize(
    ("episodes", "early", "late", "since"),
    [
        (range(100, 10_001, 100), range(100, 501, 100), range(9100, 10_001, 100), range(1100, 2001, 100)),
        ([30], [30], [30], [30]),
        ([100, 200, 250], [100], [250], [250]),  # the last block is shorter
    ],
)
def test_windows_are_the_first_500_and_the_last_1000_or_less_of_a_shorter_training_but_never_none(
    episodes, early, late, since
):
    learned = curves(episodes)
    for window, wanted in ((learned.early(), early), (learned.late(), late), (learned.within(1000, 2000), since)):
        np.testing.assert_array_equal(window.episodes, wanted)
        assert window.touches.shape[1] == len(wanted)


def test_rates_are_per_hundred_episodes_averages_weigh_blocks_by_their_steps_and_r3_is_square_less_star():
    learned = curves([100, 200, 250])
    np.testing.assert_allclose(learned.per_hundred().sum(axis=2), 100)
    assert learned.mean_rates()["square"] == pytest.approx(learned.touches[:, :, 2].sum(axis=1).mean() / 2.5)
    assert list(learned.mean_rates()) == ["circle", "star", "square", "triangle", "none"]
    learned = dataclasses.replace(
        curves([10, 40], runs=1), violation=np.array([[1.0, 0.0]]), length=np.array([[3.0, 2.0]])
    )
    assert learned.outside() == pytest.approx(30 / 90)
    earned = learned.touches[:, :, 2].sum(axis=1) - learned.touches[:, :, 1].sum(axis=1)
    np.testing.assert_allclose(learned.average_r3("episode"), earned / 40)
    np.testing.assert_allclose(learned.average_r3("step"), earned / 90)


def least_time_average(arm, episodes):
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


def test_the_bound_on_r3_is_met_by_no_policy_not_loose_and_follows_speed_and_rewards():
    bound = greatest_average_r3(ARM)
    assert 0.6 * bound < least_time_average(ARM, 300) < bound < 0.4
    assert greatest_average_r3(TwoLinkArm(max_speed=1000.0)) == pytest.approx(1.0)  # any touch within one step
    doubled = [dataclasses.replace(thing, reward=2 * thing.reward) for thing in ARM.objects]
    assert greatest_average_r3(TwoLinkArm(objects=tuple(doubled))) == pytest.approx(2 * bound)
