"""Bars count every sign of life; what is recorded is what the results hold."""

import numpy as np

from rl.experiments.progress import training_progress
from rl.experiments.three_state import Snapshot, Tick


def test_ticks_move_the_bar_and_snapshots_are_remembered():
    with training_progress(["a", "b"], 50) as progress:
        progress.listen(Snapshot("a", 20, np.zeros((1, 9)), np.zeros((1, 4))))
        progress.listen(Tick("a", 30))
        progress.listen(Tick("b", 10))
        assert progress.recorded == {"a": 20}
        assert [task.completed for task in progress.bars.tasks] == [30, 10]


def test_nothing_is_drawn_without_a_terminal(capsys):
    with training_progress(["a"], 2) as progress:
        progress.listen(Tick("a", 1))
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""
