"""The two-link arm: kinematics, rewards at their edges, stops, starts, compiled code, constants."""

import functools
import math

import numpy as np
import pytest

from envs import ArmObject, TwoLinkArm, random_state

FAR = (ArmObject("far", (9.0, 9.0)),)
WIDE = ((-3.0, 3.0), (-3.0, 3.0))


@functools.cache
def kernels_of(arm):
    return arm.continuous_kernels()


def move(arm, angles, action=(0.0, 0.0)):
    """One step of the compiled kernel."""
    kernels = kernels_of(arm)
    state, reward = np.array(angles, dtype=float), np.full(3, np.nan)
    words = random_state(np.random.SeedSequence(0))
    event = kernels.step(kernels.constants, state, np.array(action, dtype=float), words, reward)
    return state, reward, event


def starts(arm, count, seed=0):
    kernels = kernels_of(arm)
    words, states = random_state(np.random.SeedSequence(seed)), np.empty((count, 2))
    for state in states:
        kernels.reset(kernels.constants, words, state)
    return states


def at(point, **constants):
    """An arm with links 1, 1, wide stops and one object of reward 5 at `point`."""
    settings = {"box": WIDE, "objects": (ArmObject("it", point, 5.0),), **constants}
    return TwoLinkArm(**settings)


# Kinematics


def test_the_end_effector_is_where_the_closed_form_says():
    arm = TwoLinkArm(link_lengths=(3.0, 2.0))
    for angles, point in (
        ((0, math.pi / 2), (3, 2)),  # a right angle at the elbow
        ((0, math.pi), (1, 0)),  # folded back
        ((math.pi / 3, math.pi / 3), (3 / 2 - 1, 3 * math.sqrt(3) / 2 + math.sqrt(3))),
    ):
        np.testing.assert_allclose(arm.forward_kinematics(angles), point, atol=1e-15)
    arm = TwoLinkArm()
    mesh, (low, high) = arm.reachable_mesh(2), arm.stops
    np.testing.assert_allclose(mesh[0, 1], arm.forward_kinematics([low[0], high[1]]), atol=1e-15)
    inner = arm.reachable_mesh(2, within="box")
    np.testing.assert_allclose(inner[1, 0], arm.forward_kinematics([math.pi / 2, math.pi / 4]), atol=1e-15)


# Motion


def test_a_step_moves_by_velocity_times_time_clipped_at_the_speed_limit():
    arm = TwoLinkArm(objects=FAR)
    for given, taken in [((3.5, -100), (3, -3)), ((-np.inf, np.inf), (-3, 3)), ((3, -2.9), (3, -2.9))]:
        assert move(arm, (1.0, 1.5), given)[0].tolist() == move(arm, (1.0, 1.5), taken)[0].tolist()
    np.testing.assert_allclose(move(arm, (1.0, 1.5), (99, -2.0))[0], [1.15, 1.4])
    state, reward, event = move(arm, (1.0, 1.5), (np.nan, 0))  # spreads instead of becoming a move
    assert np.isnan([state[0], reward[0]]).all()
    assert (reward[1], event) == (-1, 0)


def test_stops_are_the_box_widened_by_a_quarter_of_its_width_and_hold_the_arm():
    arm = TwoLinkArm(objects=FAR)
    low, high = arm.stops
    np.testing.assert_allclose(low, [0, math.pi / 8], atol=1e-15)
    np.testing.assert_allclose(high, [0.6 * math.pi, 7 * math.pi / 8], atol=1e-15)
    assert move(arm, high, (1, 2))[0].tolist() == high.tolist()
    assert move(arm, low, (-1, -2))[0].tolist() == low.tolist()
    np.testing.assert_allclose(move(arm, high, (-1, 1))[0], high - [0.05, 0])


# Rewards


def test_the_box_holds_its_edges_and_nothing_outside():
    arm = TwoLinkArm(objects=FAR)
    for joint, edge in np.ndindex(2, 2):
        angles = np.mean(arm.box, axis=1)
        angles[joint] = arm.box[joint][edge]
        assert move(arm, angles)[1][1] == 0
        angles[joint] = np.nextafter(arm.box[joint][edge], np.inf if edge else -np.inf)
        assert move(arm, angles)[1][1] == -1


def test_the_box_is_judged_where_the_arm_was_told_to_go_not_where_the_stops_hold_it():
    arm = TwoLinkArm(objects=FAR, stop_margin=0.0)
    corner = arm.stops[1]
    state, reward, _ = move(arm, corner, (0.01, 0))
    assert state.tolist() == corner.tolist()
    assert reward[1] == -1
    assert move(arm, corner)[1][1] == 0


def test_a_touch_includes_its_edge():
    # φ = (0, π/2) puts the end effector at (1, 1) exactly; 1/16 and its square are exact too.
    arm = at((1.0625, 1.0), touch_radius=0.0625)
    assert arm.forward_kinematics([0, math.pi / 2]).tolist() == [1, 1]
    assert move(arm, (0, math.pi / 2))[2] == 1
    assert move(at((1.0625, 1.0), touch_radius=np.nextafter(0.0625, 0)), (0, math.pi / 2))[2] == 0
    assert move(at((1.0, 1.0)), (0, math.pi / 2))[1].tolist() == [1, 0, 5]  # closeness, joints, prize


def reference(arm, angles, actions):
    """The table of docs/reproduction.md §3 in NumPy, many steps at once."""
    desired = angles + arm.dt * np.clip(actions, -arm.max_speed, arm.max_speed)
    low, high = np.array(arm.box).T
    inside = ((desired >= low) & (desired <= high)).all(axis=1)
    angles = np.clip(desired, *arm.stops)
    tips = arm.forward_kinematics(angles)
    distances = np.array([np.hypot(*(tips - thing.position).T) for thing in arm.objects])
    nearest, d = distances.argmin(axis=0), distances.min(axis=0)
    prize = np.where(d <= arm.touch_radius, np.array([thing.reward for thing in arm.objects])[nearest], 0)
    rewards = np.column_stack([np.exp(-(d**2) / (2 * arm.reward_width**2)), np.where(inside, 0, -1), prize])
    return angles, rewards, np.where(d <= arm.touch_radius, nearest + 1, 0)


OTHER = TwoLinkArm(
    link_lengths=(0.8, 1.1), dt=0.1, max_speed=2.0, box=((0.2, 1.9), (0.5, 2.0)), stop_margin=0.1,
    objects=(*TwoLinkArm().objects, ArmObject("fifth", (0.9, 0.9), -0.5)), touch_radius=0.1, reward_width=0.5,
)  # fmt: skip


@pytest.mark.parametrize("arm", [TwoLinkArm(), OTHER])
def test_kernels_follow_the_table_on_random_trajectories(arm):
    actions = 2 * np.random.default_rng(0).standard_normal((60, 40, 2))
    visited, rewards, events = np.empty((60, 41, 2)), np.empty((60, 40, 3)), np.empty((60, 40), dtype=int)
    for run, start in enumerate(starts(arm, 60)):
        visited[run, 0] = start
        for t in range(40):
            visited[run, t + 1], rewards[run, t], events[run, t] = move(arm, visited[run, t], actions[run, t])
    left, arrived = visited[:, :-1].reshape(-1, 2), visited[:, 1:].reshape(-1, 2)
    expected = reference(arm, left, actions.reshape(-1, 2))
    assert arrived.tolist() == expected[0].tolist()
    np.testing.assert_allclose(rewards.reshape(-1, 3), expected[1], rtol=1e-12)
    assert events.ravel().tolist() == expected[2].tolist()
    assert len(set(events.ravel())) >= 4  # the comparison saw touches
    tips = arm.forward_kinematics(arrived)
    np.testing.assert_allclose(arm.intrinsic_reward(tips), rewards[..., 0].ravel(), rtol=1e-12)
    assert arm.touched(tips).tolist() == expected[2].tolist()


# Starts


def test_starts_touch_nothing_and_are_uniform_elsewhere():
    arm = TwoLinkArm(touch_radius=0.2)
    states = starts(arm, 20_000)
    assert (arm.touched(arm.forward_kinematics(states)) == 0).all()
    low, high = np.array(arm.box).T
    grid = np.stack(np.meshgrid(*np.linspace(low, high, 101).T, indexing="ij"), axis=-1)
    free = arm.touched(arm.forward_kinematics(grid)) == 0
    corners = range(0, 100, 10)
    cells = np.array([[free[i : i + 11, j : j + 11].all() for j in corners] for i in corners])
    counts = np.histogram2d(*states.T, bins=10, range=arm.box)[0]
    assert 25 < cells.sum() < 75
    assert counts[~cells].mean() < 0.9 * counts[cells].mean()
    assert ((states >= low) & (states <= high)).all()
    expected = counts[cells].mean()
    assert ((counts[cells] - expected) ** 2 / expected).sum() < 150  # χ², below 75 degrees of freedom: p < 1e-6


# Constants


def test_constants_are_the_ones_of_the_paper_and_of_the_table():
    arm = TwoLinkArm()
    assert arm.box == ((math.pi / 10, math.pi / 2), (math.pi / 4, 3 * math.pi / 4))
    assert (arm.link_lengths, arm.dt, arm.max_speed, arm.stop_margin) == ((1, 1), 0.05, 3, 0.25)
    assert (arm.touch_radius, arm.reward_width, arm.max_steps) == (0.06, 0.3, 1000)
    assert {thing.name: (*thing.position, thing.reward) for thing in arm.objects} == {
        "circle": (-0.69, 0.87, 0),
        "star": (-0.04, 1.11, -1),
        "square": (0.58, 1.56, 1),
        "triangle": (-0.45, 1.60, 0),
    }


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: TwoLinkArm(box=((1, 0), (0, 1))), r"box should hold \(least, greatest\) angles.*\(1.0, 0.0\)"),
        (lambda: TwoLinkArm(objects=FAR * 2), r"objects should have different names; found \['far', 'far'\]"),
        (lambda: TwoLinkArm(touch_radius=4.0), "should be free of objects to start in; found 0.00%"),
        (lambda: ArmObject("none", (0, 0)), "not 'none'; found 'none'"),
        (lambda: ArmObject("it", (0, 0, 0)), "position of it should be a pair of numbers"),
        (lambda: TwoLinkArm().forward_kinematics([1, 2, 3]), r"angles should have shape \(…, 2\)"),
        (lambda: TwoLinkArm().reachable_mesh(1), "lines should be an integer ≥ 2; found 1"),
    ],
)
def test_what_makes_no_arm_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
