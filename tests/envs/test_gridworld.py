"""Facts and laws of the gridworld."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envs import GridWorld

FREE = [-np.inf, -np.inf]


@st.composite
def worlds(draw):
    """Up to 4 × 5 cells; walls nowhere or in a place that parts nothing, hazards of up to two kinds."""
    height, width = draw(st.integers(1, 4)), draw(st.integers(2, 5))
    marks = draw(st.lists(st.sampled_from("..ab"), min_size=height * width, max_size=height * width))
    start, goal = draw(st.permutations(range(height * width)))[:2]
    marks[start], marks[goal] = "S", "G"
    corner = draw(st.sampled_from([0, width - 1, width * height - width, width * height - 1]))
    if height > 1 and corner not in (start, goal):
        marks[corner] = "#"
    layout = ["".join(marks[row * width : (row + 1) * width]) for row in range(height)]
    return GridWorld(layout, slip=draw(st.sampled_from([0.0, 0.1, 0.7])))


@settings(max_examples=20)
@given(worlds())
def test_moves_reach_neighbours_and_no_wall(world):
    cells = np.array(world.cells)
    goal = int(world.rewards[0, :, 0].argmax())
    np.testing.assert_allclose(world.transitions.sum(axis=2), 1, rtol=1e-15)
    for state in set(range(world.states)) - {goal}:
        reached = world.transitions[state].any(axis=0)
        assert (np.abs(cells[reached] - cells[state]).sum(axis=1) <= 1).all()
    assert (world.transitions[goal, :, world.start] == 1).all()


@settings(max_examples=20)
@given(worlds(), st.integers(0, 2**32))
def test_the_averages_are_the_shares_of_time(world, seed):
    policy = np.random.default_rng(seed).dirichlet(np.ones(4), size=world.states)
    shares = world.stationary_distribution(policy)
    of = dict.fromkeys("Gab", 0.0)
    for share, (row, column) in zip(shares, world.cells, strict=True):
        mark = world.layout[row][column]
        of[mark] = of.get(mark, 0.0) + share
    expected = [of["G"], *(-of[kind] for kind in world.hazards)]
    np.testing.assert_allclose(world.average_rewards(policy), expected, atol=1e-15)


def test_slipping_turns_the_move_by_a_right_angle():
    world = GridWorld(["...", ".S.", "..G"], slip=0.2)
    chances = np.zeros((3, 3))
    chances[tuple(np.transpose(world.cells))] = world.transitions[world.start, 1]  # to the east
    np.testing.assert_allclose(chances, [[0, 0.1, 0], [0, 0, 0.8], [0, 0.1, 0]], rtol=1e-15)


@pytest.mark.parametrize(("thresholds", "moves"), [(FREE, 4), ([0.0, -np.inf], 6), ([0.0, 0.0], 8)])
def test_without_slip_the_best_way_has_as_many_moves_as_the_map_shows(thresholds, moves):
    best = GridWorld(slip=0.0).constrained_optimum(thresholds).values[0]
    assert best == pytest.approx(1 / (moves + 1), abs=1e-10)


def test_where_each_round_passes_through_a_hazard_its_threshold_bounds_the_rounds():
    world = GridWorld(["SaG"], slip=0.0)
    for bound in (0.3, 0.1, 0.0):
        np.testing.assert_allclose(world.constrained_optimum([-bound]).values, [bound, -bound], atol=1e-10)


@pytest.mark.parametrize(
    ("layout", "message"),
    [
        ("S.G", "layout should be strings, one a row; found 'S.G'"),
        (["S.", "G"], r"layout should have rows of one length; found \[2, 1\]"),
        (["S.?G"], "layout should consist of S, G, ., # and a … z; found '\\?'"),
        (["S.SG"], "layout should have one S and one G; found 2 and 1 of them"),
        (["S.#.", "..#G"], r"layout should have a way from S to each cell that is no wall; found none to \(0, 3\)"),
    ],
)
def test_other_layouts_are_refused(layout, message):
    with pytest.raises(ValueError, match=message):
        GridWorld(layout)
