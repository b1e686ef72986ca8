"""Bars count every sign of life; what is recorded is what the results hold."""

from rl.experiments.progress import training_progress
from rl.experiments.records import Advance


def test_ticks_move_the_bar_and_records_are_remembered():
    with training_progress({"a": 50, "b": 10}) as progress:
        progress.listen(Advance("a", 20, True))
        progress.listen(Advance("a", 30, False))
        progress.listen(Advance("b", 10, False))
        assert progress.recorded == {"a": 20}
        assert [task.completed for task in progress.bars.tasks] == [30, 10]


def test_nothing_is_drawn_without_a_terminal(capsys):
    with training_progress({"a": 2}) as progress:
        progress.listen(Advance("a", 1, False))
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""
