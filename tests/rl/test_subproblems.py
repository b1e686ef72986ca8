"""`--record`: what is kept of a training, by however many processes, and that watching changes nothing."""

from dataclasses import replace

import numpy as np

from cpgrl_opt.comparison.recording import load_recording
from rl.experiments.arm import ArmExperiment
from rl.experiments.share import train_share
from rl.experiments.subproblems import FILE, write_subproblems
from rl.experiments.three_state import ThreeStateExperiment

TINY = ThreeStateExperiment(runs=2, episodes=25, steps=20, record_every=25, record=40)
ARM = ArmExperiment(runs=3, episodes=8, record=1000)


def train(settings, label):
    """All runs of one of its trainings."""
    case = next(case for case in settings.cases() if case.label == label)
    return train_share((settings, case, tuple(range(settings.runs))), lambda _: None)


def test_watching_a_training_does_not_change_it_and_keeps_what_was_asked_for():
    learned, kept = [], []
    for record in (0, 40):
        outcome = train(replace(TINY, record=record), "cpgrl")
        kept.append(outcome.recording)
        learned.append(outcome.parameters)
    assert np.array_equal(*learned)
    assert kept[0] is None
    assert 0 < len(kept[1]) <= 40
    assert kept[1].episode.min() >= 1
    assert kept[1].episode.max() <= TINY.episodes


def test_methods_without_direction_problems_record_none():
    assert train(replace(TINY, episodes=2), "sum").recording is None


def test_runs_shared_out_leave_the_same_file_as_all_together(tmp_path):
    case = next(case for case in ARM.cases() if case.label == "c")
    for name, shares in (("one", [(0, 1, 2)]), ("two", [(0, 1), (2,)])):
        outcomes = [train_share((ARM, case, runs), lambda _: None) for runs in shares]
        (tmp_path / name).mkdir()
        write_subproblems([outcome.recording for outcome in outcomes], tmp_path / name)
    assert (tmp_path / "one" / FILE).read_bytes() == (tmp_path / "two" / FILE).read_bytes()
    recording = load_recording(tmp_path / "one" / FILE)
    assert recording.trainings == ("c",)
    assert set(recording.run) == {0, 1, 2}
    assert recording.jacobian.shape[1:] == (2, 82)  # the ridge adds a column for each constraint
