"""The two-link arm: kinematics, rewards at their edges, stops, starts, compiled code."""

import functools
import math
import subprocess
import sys

import numba
import numpy as np
import pytest
from numba import types

from envs import (
    RESET_SIGNATURE,
    STEP_SIGNATURE,
    ArmObject,
    ContinuousEnvironment,
    FiniteEnvironment,
    TwoLinkArm,
    VectorReward,
    function_type,
    random_state,
)

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


@pytest.mark.parametrize(
    ("angles", "point"),
    [
        ((0, 0), (5, 0)),  # stretched along x
        ((math.pi / 2, 0), (0, 5)),  # stretched upwards
        ((0, math.pi / 2), (3, 2)),  # a right angle at the elbow
        ((0, math.pi), (1, 0)),  # folded back
        ((math.pi / 3, math.pi / 3), (3 / 2 - 1, 3 * math.sqrt(3) / 2 + math.sqrt(3))),
        ((math.pi / 2, -math.pi / 2), (2, 3)),
    ],
)
def test_the_end_effector_is_where_the_closed_form_says(angles, point):
    arm = TwoLinkArm(link_lengths=(3.0, 2.0))
    np.testing.assert_allclose(arm.forward_kinematics(angles), point, atol=1e-15)


def test_the_reach_follows_the_law_of_cosines():
    arm = TwoLinkArm(link_lengths=(1.3, 0.7))
    angles = np.random.default_rng(0).uniform(-4, 4, (5, 40, 2))
    squared = (arm.forward_kinematics(angles) ** 2).sum(axis=-1)
    np.testing.assert_allclose(squared, 1.3**2 + 0.7**2 + 2 * 1.3 * 0.7 * np.cos(angles[..., 1]), rtol=1e-12)


def test_both_links_keep_their_lengths():
    arm = TwoLinkArm(link_lengths=(1.3, 0.7))
    angles = np.random.default_rng(1).uniform(-4, 4, (100, 2))
    elbow = arm.elbow(angles)
    np.testing.assert_allclose(np.linalg.norm(elbow, axis=1), 1.3, rtol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(arm.forward_kinematics(angles) - elbow, axis=1), 0.7, rtol=1e-12)


def test_the_mesh_spans_what_the_joints_reach():
    arm = TwoLinkArm()
    low, high = arm.stops
    mesh = arm.reachable_mesh(9)
    assert mesh.shape == (9, 9, 2)
    np.testing.assert_allclose(mesh[0, -1], arm.forward_kinematics([low[0], high[1]]), atol=1e-15)
    np.testing.assert_allclose(mesh[-1, 0], arm.forward_kinematics([high[0], low[1]]), atol=1e-15)
    np.testing.assert_allclose(mesh[4, 4], arm.forward_kinematics((low + high) / 2), atol=1e-14)
    inner = arm.reachable_mesh(2, within="box")
    np.testing.assert_allclose(inner[1, 0], arm.forward_kinematics([math.pi / 2, math.pi / 4]), atol=1e-15)


def test_every_object_of_the_paper_can_be_touched_without_leaving_the_box():
    mesh = TwoLinkArm().reachable_mesh(200, within="box")
    assert set(np.unique(TwoLinkArm().touched(mesh))) == {0, 1, 2, 3, 4}


# Motion


def test_stops_are_the_box_widened_by_a_quarter_of_its_width():
    low, high = TwoLinkArm().stops
    np.testing.assert_allclose(low, [0, math.pi / 8], atol=1e-15)
    np.testing.assert_allclose(high, [0.6 * math.pi, 7 * math.pi / 8], atol=1e-15)


def test_a_step_moves_by_velocity_times_time():
    state, _, _ = move(TwoLinkArm(objects=FAR), (1.0, 1.5), (0.8, -2.0))
    np.testing.assert_allclose(state, [1.04, 1.4], rtol=1e-14)


def test_actions_beyond_the_speed_limit_are_clipped():
    arm = TwoLinkArm(objects=FAR)
    for given, taken in [((3.5, -100), (3, -3)), ((-np.inf, np.inf), (-3, 3)), ((3, -2.9), (3, -2.9))]:
        assert move(arm, (1.0, 1.5), given)[0].tolist() == move(arm, (1.0, 1.5), taken)[0].tolist()
    np.testing.assert_allclose(move(arm, (1.0, 1.5), (99, 0))[0], [1.15, 1.5])
    np.testing.assert_allclose(move(TwoLinkArm(objects=FAR, max_speed=1.0), (1.0, 1.5), (99, 0))[0], [1.05, 1.5])


def test_stops_hold_the_arm():
    arm = TwoLinkArm(objects=FAR)
    low, high = arm.stops
    assert move(arm, high, (1, 2))[0].tolist() == high.tolist()
    assert move(arm, low, (-1, -2))[0].tolist() == low.tolist()
    np.testing.assert_allclose(move(arm, high, (-1, 1))[0], high - [0.05, 0])


def test_nan_in_compiled_code_spreads_instead_of_becoming_a_move():
    state, reward, event = move(TwoLinkArm(), (1.0, 1.5), (np.nan, 0))
    assert np.isnan(state[0])
    assert np.isnan(reward[0])
    assert reward[1] == -1
    assert event == 0


# Rewards


@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("edge", [0, 1])
def test_the_box_holds_its_edges_and_nothing_outside(joint, edge):
    arm = TwoLinkArm(objects=FAR)
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


def test_channels_are_closeness_joints_and_prize_in_this_order():
    _, reward, event = move(at((1.0, 1.0)), (0, math.pi / 2))
    assert reward.tolist() == [1, 0, 5]
    assert event == 1
    # One reward width away: exp(−½), no touch, no prize.
    _, reward, event = move(at((1.3, 1.0)), (0, math.pi / 2))
    np.testing.assert_allclose(reward, [math.exp(-0.5), 0, 0])
    assert event == 0


def test_the_first_reward_is_one_at_the_centre_of_every_object():
    arm = TwoLinkArm()
    assert arm.intrinsic_reward([thing.position for thing in arm.objects]).tolist() == [1, 1, 1, 1]


def test_the_first_reward_falls_off_from_the_nearest_object():
    arm = TwoLinkArm()
    x, y = arm.objects[2].position
    np.testing.assert_allclose(arm.intrinsic_reward([x + 0.6, y]), math.exp(-2))
    points = np.random.default_rng(0).uniform(-2, 2, (7, 8, 2))
    each = [TwoLinkArm(objects=(thing,)).intrinsic_reward(points) for thing in arm.objects]
    np.testing.assert_allclose(arm.intrinsic_reward(points), np.max(each, axis=0))


@pytest.mark.parametrize(("name", "prize"), [("circle", 0), ("star", -1), ("square", 1), ("triangle", 0)])
def test_only_star_and_square_are_worth_anything(name, prize):
    arm = TwoLinkArm()
    x, y = arm.objects[arm.events.index(name)].position
    # The elbow's angle from the law of cosines, then the shoulder's.
    second = math.acos((x**2 + y**2 - 2) / 2)
    first = math.atan2(y, x) - second / 2
    _, reward, event = move(arm, (first, second))
    np.testing.assert_allclose(reward, [1, 0, prize], atol=1e-12)
    assert arm.continuous_kernels().events[event - 1] == name


def test_of_two_objects_within_reach_the_nearer_is_touched():
    pair = (ArmObject("first", (1.05, 1.0), 2.0), ArmObject("second", (0.96, 1.0), 3.0))
    arm = TwoLinkArm(box=WIDE, objects=pair)
    assert (move(arm, (0, math.pi / 2))[2], move(arm, (0, math.pi / 2))[1][2]) == (2, 3)
    arm = TwoLinkArm(box=WIDE, objects=pair[::-1])
    assert (move(arm, (0, math.pi / 2))[2], move(arm, (0, math.pi / 2))[1][2]) == (1, 3)


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
    link_lengths=(0.8, 1.1),
    dt=0.1,
    max_speed=2.0,
    box=((0.2, 1.9), (0.5, 2.0)),
    stop_margin=0.1,
    objects=(*TwoLinkArm().objects, ArmObject("fifth", (0.9, 0.9), -0.5)),
    touch_radius=0.1,
    reward_width=0.5,
)


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


def test_starts_are_uniform_in_the_box():
    states = starts(TwoLinkArm(objects=FAR), 20_000)
    box = np.array(TwoLinkArm().box)
    assert ((states >= box[:, 0]) & (states <= box[:, 1])).all()
    counts = np.histogram2d(*states.T, bins=10, range=box)[0]
    assert ((counts - 200) ** 2 / 200).sum() < 180  # χ² with 99 degrees of freedom: p ≈ 1e-6


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
    expected = counts[cells].mean()
    assert ((counts[cells] - expected) ** 2 / expected).sum() < 150  # χ², below 75 degrees of freedom: p < 1e-6


def test_streams_fix_the_starts():
    assert starts(TwoLinkArm(), 5, seed=1).tolist() == starts(TwoLinkArm(), 5, seed=1).tolist()
    assert starts(TwoLinkArm(), 5, seed=1).tolist() != starts(TwoLinkArm(), 5, seed=2).tolist()


# Compiled path


def test_a_compiled_rollout_takes_the_kernels_as_arguments():
    @numba.njit(
        types.Tuple((types.int64, types.int64))(
            function_type(RESET_SIGNATURE),
            function_type(STEP_SIGNATURE),
            types.float64[::1],
            types.uint64[::1],
            types.float64[:, ::1],
            types.float64[:, ::1],
        )
    )
    def rollout(reset, step, constants, words, actions, rewards):
        state = np.empty(2)
        reset(constants, words, state)
        for t in range(len(actions)):
            event = step(constants, state, actions[t], words, rewards[t])
            if event != 0:
                return t + 1, event
        return len(actions), 0

    arm = TwoLinkArm(touch_radius=0.2)
    kernels = arm.continuous_kernels()
    actions, rewards = np.random.default_rng(0).normal(size=(400, 2)), np.zeros((400, 3))
    words = random_state(np.random.SeedSequence(5))
    steps, event = rollout(kernels.reset, kernels.step, kernels.constants, words, actions, rewards)
    angles, expected = starts(arm, 1, seed=5)[0], []
    for action in actions[:steps]:
        angles, reward, last = move(arm, angles, action)
        expected.append(reward.tolist())
    assert rewards[:steps].tolist() == expected
    assert event == last
    assert steps == 400 or event > 0


def test_a_second_process_takes_the_kernels_from_the_cache():
    TwoLinkArm().continuous_kernels()
    program = (
        "from envs import TwoLinkArm; kernels = TwoLinkArm().continuous_kernels();"
        "print([sum(k.stats.cache_misses.values()) for k in (kernels.reset, kernels.step)])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[0, 0]"


def test_the_arm_offers_the_continuous_path():
    arm = TwoLinkArm(max_steps=7)
    assert isinstance(arm, VectorReward)
    assert isinstance(arm, ContinuousEnvironment)
    assert not isinstance(arm, FiniteEnvironment)
    kernels = arm.continuous_kernels()
    assert (kernels.state_size, kernels.action_size, kernels.reward_channels, kernels.max_steps) == (2, 2, 3, 7)
    assert kernels.events == ("circle", "star", "square", "triangle")
    kernels.constants[:] = 0
    assert arm.continuous_kernels().constants[0] == 1  # fresh each time
