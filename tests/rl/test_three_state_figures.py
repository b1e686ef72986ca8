"""Figures drawn from known curves show those numbers: bands, optimum, thresholds, triangles and paths."""

import matplotlib as mpl
import numpy as np
import pytest

from envs import ThreeStateMDP
from rl.experiments.figure_style import blank_figure, panel_letter, paper_style, save_figure
from rl.experiments.three_state import METHODS
from rl.experiments.three_state.curves import LearningCurves
from rl.experiments.three_state.figures import LABELS, averages_figure, policies_figure

EPISODES = np.arange(0, 501, 100)
OPTIMUM, THRESHOLDS = np.array([0.7, 0.1, 0.2, 0.3]), np.array([0.05, 0.15, 0.25])
# As somebody's matplotlibrc may have it.
ODD = {
    "axes.grid": True,
    "axes.facecolor": "black",
    "lines.linestyle": "--",
    "savefig.bbox": "tight",
    "savefig.transparent": True,
    "svg.fonttype": "none",
    "figure.subplot.left": 0.4,
}


@pytest.fixture(scope="module")
def curves():
    rng = np.random.default_rng(0)
    policies = rng.dirichlet(np.ones(3), size=(4, 4, len(EPISODES), 3))
    averages = ThreeStateMDP().average_rewards
    return {
        method: LearningCurves(EPISODES, rng.normal(size=(4, len(EPISODES), 4)), averages(own), own)
        for method, own in zip(METHODS, policies, strict=True)
    }


def line(axes, label):
    return next(each for each in axes.get_lines() if each.get_label() == label)


def test_fig4_shows_means_bands_optimum_and_thresholds(curves):
    figure = averages_figure(curves, OPTIMUM, THRESHOLDS)
    panels = [axes for axes in figure.axes if axes.get_title(loc="left")]
    assert len(panels) == 4
    for channel, axes in enumerate(panels):
        for method, label in LABELS.items():
            mean = curves[method].estimated[:, :, channel].mean(axis=0)
            np.testing.assert_allclose(line(axes, label).get_xydata(), np.column_stack([EPISODES, mean]))
        assert line(axes, "exact constrained optimum").get_ydata()[0] == OPTIMUM[channel]
        shaded = [patch for patch in axes.patches if patch.get_label() == "constraint violated"]
        assert [patch.get_y() + patch.get_height() for patch in shaded] == pytest.approx(THRESHOLDS[:channel][-1:])
    band = panels[0].collections[0].get_paths()[0].vertices
    values = curves["cpgrl"].estimated[:, 2, 0]
    at_episode = band[band[:, 0] == EPISODES[2], 1]
    ends = values.mean() + np.array([-1, 1]) * values.std(ddof=1)
    assert [at_episode.min(), at_episode.max()] == pytest.approx(ends)


def test_fig5_paths_are_the_policies_and_grey_is_the_exact_average_reward(curves):
    mdp = ThreeStateMDP()
    figure = policies_figure(curves, mdp)
    corners = {(0, -1): [1, 0, 0], (-1, 0): [0, 1, 0], (0, 0): [0, 0, 1]}
    for row, learned in enumerate(curves.values()):
        for state in range(3):
            axes = figure.axes[3 * row + state]
            drawn = [each.get_xydata() for each in axes.get_lines()]
            paths = learned.policies[:, :, state, :2]
            for path in (*paths, paths.mean(axis=0)):
                assert any(np.array_equal(path, each) for each in drawn)
            grey = axes.get_images()[0].get_array()
            for corner, probabilities in corners.items():
                policy = learned.policies[:, -1].mean(axis=0)
                policy[state] = probabilities
                assert grey[corner] == pytest.approx(mdp.average_rewards(policy)[0])


def test_a_users_matplotlibrc_changes_no_byte_and_is_not_changed(tmp_path):
    def draw(name):
        (tmp_path / name).mkdir()
        with paper_style():
            figure = blank_figure(3.0, 2.0)
            axes = figure.subplots()
            axes.plot(np.arange(5) ** 2, label="squares")
            axes.legend()
            panel_letter(axes, "a", "title")
            return [path.read_bytes() for path in save_figure(figure, tmp_path / name, "figure")]

    plain = draw("plain")
    with mpl.rc_context(ODD):
        before = dict(mpl.rcParams)
        assert draw("odd") == plain
        assert dict(mpl.rcParams) == before
