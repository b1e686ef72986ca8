"""Figures 6 and 7 and the animation show what they are given; learned paths are what the policies do."""

import itertools

import numpy as np
import pytest
from PIL import Image

from envs import TwoLinkArm
from rl.experiments.arm import arm_policy
from rl.experiments.arm.animation import write_animation
from rl.experiments.arm.conditions import CONDITIONS
from rl.experiments.arm.curves import TouchCurves
from rl.experiments.arm.figures import touches_figure, workspace_figure
from rl.experiments.arm.paths import (
    ArmPath,
    arm_path,
    count_touches,
    starts_beside_aversive,
    typical_path,
    typical_run,
)
from rl.experiments.figure_style import paper_style

ARM = TwoLinkArm()
STARTS = starts_beside_aversive(ARM)
SQUARE = np.array([0.58, 1.56])


def homing(gain=60.0):
    """A policy whose mean velocity leads to the square from everywhere: towards angles that touch it."""
    policy = arm_policy(ARM)
    places = np.stack(np.meshgrid(*np.linspace(*ARM.stops, 200).T, indexing="ij"), axis=-1).reshape(-1, 2)
    goal = places[np.hypot(*(ARM.forward_kinematics(places) - SQUARE).T).argmin()]
    axes = [policy.low[k] + policy.spacing[k] * np.arange(policy.counts[k]) for k in range(2)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    return policy.with_parameters((gain * (goal - centres)).reshape(-1))


def curves(runs=4, blocks=8, seed=0):
    rng = np.random.default_rng(seed)
    sizes = np.full(blocks, 100)
    touches = rng.multinomial(100, (0.1, 0.2, 0.3, 0.35, 0.05), size=(runs, blocks))
    rates = rng.uniform(0, 1, (2, runs, blocks))
    return TouchCurves(ARM, np.cumsum(sizes), sizes, touches, rates[0], 1 + rates[1])


CURVES = {"a": curves(), "b": curves(seed=1), "c": curves(seed=2)}
TITLES = {name: CONDITIONS[name].title for name in "abc"}
PATHS = {name: ArmPath(np.linspace(STARTS[k], STARTS[k + 1], 9), "star") for k, name in enumerate("abc")}


def test_starts_lie_all_around_the_star_in_the_box_and_touch_nothing():
    points = ARM.forward_kinematics(STARTS)
    offsets = points - (-0.04, 1.11)
    np.testing.assert_allclose(np.hypot(*offsets.T), 0.16, atol=0.03)
    assert len(np.unique(np.round(np.arctan2(*offsets.T[::-1]) / (np.pi / 4)) % 8)) == 8
    low, high = np.array(ARM.box).T
    assert ((low <= STARTS) & (high >= STARTS)).all()
    assert not ARM.touched(points).any()


def test_a_path_begins_at_its_start_moves_as_the_arm_and_ends_at_what_it_touched():
    path = arm_path(ARM, homing(), STARTS[0], np.random.default_rng(0))
    np.testing.assert_array_equal(path.angles[0], STARTS[0])
    assert (np.abs(np.diff(path.angles, axis=0)) <= ARM.dt * ARM.max_speed + 1e-12).all()
    touched = ARM.touched(ARM.forward_kinematics(path.angles))
    assert (path.touched, touched[-1], touched[:-1].any()) == ("square", 3, False)
    short = TwoLinkArm(max_steps=5)
    path = arm_path(short, arm_policy(short), STARTS[3], np.random.default_rng(0))
    assert (path.touched, len(path.angles)) == ("none", 6)


def test_the_typical_path_has_median_length_and_the_typical_run_is_nearest_to_the_mean(monkeypatch):
    learned = curves(runs=3)
    learned.touches[:] = np.array([[100, 0, 0, 0, 0], [60, 0, 40, 0, 0], [30, 0, 70, 0, 0]])[:, None]
    assert typical_run(learned) == 1
    lengths = iter([40, 3, 9, 41, 4, 8, 42, 5, 7, 43, 6, 44, 10, 45, 11])
    made = (ArmPath(np.zeros((length, 2)), "square" if length < 40 else "star") for length in lengths)
    monkeypatch.setattr("rl.experiments.arm.paths.arm_path", lambda *_: next(made))
    path = typical_path(ARM, arm_policy(ARM), STARTS[0], np.random.default_rng(0))
    assert (path.touched, len(path.angles)) == ("square", 7)  # of those that end as most do


def test_ends_from_all_around_are_counted_per_hundred_episodes():
    ends = count_touches(ARM, [homing()], STARTS, np.random.default_rng(1))
    assert list(ends) == [*ARM.events, "none"]
    assert ends["square"] >= 70
    assert sum(ends.values()) == pytest.approx(100)


def test_fig7_shows_means_bands_and_paths():
    figure = touches_figure(CURVES, PATHS, TITLES)
    above, below = figure.axes[:3], figure.axes[3:6]
    for axes, lower, (name, learned) in zip(above, below, CURVES.items(), strict=True):
        rates = learned.per_hundred()
        lines = {line.get_label(): line for line in axes.get_lines()}
        for k, label in enumerate(("circle", "star", "square", "triangle", "none (time-out)")):
            shown = np.column_stack([learned.episodes, rates[:, :, k].mean(axis=0)])
            np.testing.assert_allclose(lines[label].get_xydata(), shown)
        band = axes.collections[2].get_paths()[0].vertices  # of the square
        at = band[band[:, 0] == 300, 1]
        assert at.max() - at.min() == pytest.approx(2 * rates[:, 2, 2].std(ddof=1))
        way = ARM.forward_kinematics(PATHS[name].angles)
        assert any(np.array_equal(line.get_xydata(), way) for line in lower.get_lines())
        assert f"({name})" in axes.get_title(loc="left")
        assert [text.get_text() for text in lower.texts] == ["star, 8 steps"]


def test_fig6_shows_mesh_objects_and_the_intrinsic_reward():
    left, right = workspace_figure(ARM).axes[:2]
    drawn, mesh = [line.get_xydata() for line in left.get_lines()], ARM.reachable_mesh(25)
    for wanted in (mesh[7], mesh[:, 7], *([thing.position] for thing in ARM.objects)):
        assert any(np.array_equal(wanted, line) for line in drawn)
    image = right.get_images()[0]
    x0, x1, y0, y1 = image.get_extent()
    rows, columns = image.get_array().shape
    for x, y in ((0.58, 1.56), (-0.04, 1.3), (1.0, 0.3)):
        place = round((y - y0) / (y1 - y0) * (rows - 1)), round((x - x0) / (x1 - x0) * (columns - 1))
        assert image.get_array()[place] == pytest.approx(float(ARM.intrinsic_reward([x, y])), abs=0.02)


def test_the_animation_plays_every_episode_in_real_time_and_repeats(tmp_path):
    short, long = ArmPath(np.linspace(*STARTS[:2], 5), "none"), ArmPath(np.linspace(*STARTS[2:4], 300), "square")
    path = tmp_path / "fig7.gif"
    with paper_style():
        write_animation(ARM, {"a": [short, short], "c": [short, long]}, {"a": "", "c": ""}, path)
    with Image.open(path) as movie:
        assert movie.info["loop"] == 0
        pictures, durations = [], []
        for k in range(movie.n_frames):
            movie.seek(k)
            pictures.append(np.asarray(movie.convert("RGB")))
            durations.append(movie.info["duration"])
    assert len(pictures) == 5 + 45  # the long one in strides
    assert durations[:4] == [50] * 4
    assert durations[4] == durations[-1] > 1000
    assert all((before != after).any() for before, after in itertools.pairwise(pictures[5:]))
    half = pictures[0].shape[1] // 2
    assert not (pictures[20][:, :half] != pictures[30][:, :half]).any()  # the shorter one waits at its end
