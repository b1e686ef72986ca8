"""Figures drawn from known curves show those numbers: bands, optimum, thresholds, triangles and paths."""

import numpy as np
import pytest

from envs import ThreeStateMDP
from rl.experiments.figure_style import paper_style
from rl.experiments.three_state import METHODS
from rl.experiments.three_state.curves import LearningCurves
from rl.experiments.three_state.figures import LABELS, averages_figure, policies_figure

EPISODES = np.arange(0, 501, 100)


@pytest.fixture(scope="module")
def curves():
    rng = np.random.default_rng(0)
    mdp = ThreeStateMDP()
    policies = rng.dirichlet(np.ones(3), size=(4, 4, len(EPISODES), 3))
    return {
        method: LearningCurves(EPISODES, rng.normal(size=(4, len(EPISODES), 4)), mdp.average_rewards(own), own)
        for method, own in zip(METHODS, policies, strict=True)
    }


def line(axes, label):
    return next(each for each in axes.get_lines() if each.get_label() == label)


def test_fig4_shows_means_optimum_and_thresholds(curves):
    optimum, thresholds = np.array([0.7, 0.1, 0.2, 0.3]), np.array([0.05, 0.15, 0.25])
    figure = averages_figure(curves, optimum, thresholds)
    panels = [axes for axes in figure.axes if axes.get_title(loc="left")]
    assert len(panels) == 4
    for channel, axes in enumerate(panels):
        for method, label in LABELS.items():
            mean = curves[method].estimated[:, :, channel].mean(axis=0)
            np.testing.assert_allclose(line(axes, label).get_xydata(), np.column_stack([EPISODES, mean]))
        assert line(axes, "exact constrained optimum").get_ydata()[0] == optimum[channel]
        shaded = [patch for patch in axes.patches if patch.get_label() == "constraint violated"]
        assert len(shaded) == (channel > 0)
        if shaded:
            assert shaded[0].get_y() + shaded[0].get_height() == pytest.approx(thresholds[channel - 1])


def test_fig4_bands_are_one_standard_deviation_wide(curves):
    figure = averages_figure(curves, np.zeros(4), np.zeros(3))
    band = figure.axes[0].collections[0].get_paths()[0].vertices
    values = curves["cpgrl"].estimated[:, :, 0]
    middle, deviation = values.mean(axis=0)[2], values.std(axis=0, ddof=1)[2]
    at_episode = band[band[:, 0] == EPISODES[2], 1]
    assert at_episode.min() == pytest.approx(middle - deviation)
    assert at_episode.max() == pytest.approx(middle + deviation)


def test_fig5_paths_are_the_policies_of_method_and_state(curves):
    figure = policies_figure(curves, ThreeStateMDP())
    for row, method in enumerate(curves):
        for state in range(3):
            lines = figure.axes[3 * row + state].get_lines()
            drawn = [tuple(map(tuple, each.get_xydata())) for each in lines]
            for run in curves[method].policies[:, :, state, :2]:
                assert tuple(map(tuple, run)) in drawn
            assert tuple(map(tuple, curves[method].policies[:, :, state, :2].mean(axis=0))) in drawn


def test_fig5_grey_is_the_exact_average_reward(curves):
    mdp = ThreeStateMDP()
    figure = policies_figure(curves, mdp)
    final = curves["conb"].policies[:, -1].mean(axis=0)
    for state in range(3):
        grey = figure.axes[3 + state].get_images()[0].get_array()
        corners = {(0, -1): [1, 0, 0], (-1, 0): [0, 1, 0], (0, 0): [0, 0, 1]}
        for corner, probabilities in corners.items():
            policy = final.copy()
            policy[state] = probabilities
            assert grey[corner] == pytest.approx(mdp.average_rewards(policy)[0])


def test_drawing_leaves_matplotlibs_settings_alone(curves):
    import matplotlib

    before = dict(matplotlib.rcParams)
    with paper_style():
        assert matplotlib.rcParams["font.family"] == ["STIXGeneral"]
        averages_figure(curves, np.zeros(4), np.zeros(3))
    assert dict(matplotlib.rcParams) == before
