"""Observers see every record, change no number, and do not end a training."""

import csv
import struct

import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep
from envs import ThreeStateMDP
from rl import CPGRL, GPOMDP, SoftmaxTable, Training
from rl.observers import CsvLog, ObserverWarning, ProgressBar, ProgressBars, TensorBoardLog, quantities, watch


def training():
    learner = CPGRL(ConstrainedStep(), [0.0] * 3)
    return Training(ThreeStateMDP(), SoftmaxTable(3, 3), GPOMDP(steps=20), learner, episodes=6, runs=2)


class Noting:
    def __init__(self, breaks_at=None):
        self.breaks_at, self.seen, self.closed = breaks_at, [], 0

    def see(self, record):
        self.seen.append(record.episode)
        if record.episode == self.breaks_at:
            raise OSError("no space left on device")

    def close(self):
        self.closed += 1


def test_the_csv_holds_what_the_records_do(tmp_path):
    records = list(watch(training(), CsvLog(tmp_path / "log.csv", every=2)))
    with (tmp_path / "log.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(int(row["episode"]), int(row["run"])) for row in rows] == [(k, run) for k in (2, 4, 6) for run in range(2)]
    last = records[-1]
    assert float(rows[-1]["reward_3"]) == last.estimate.rewards[1, 3]
    assert float(rows[-1]["gradient_0"]) == pytest.approx(np.linalg.norm(last.estimate.gradients[1, 0]))
    assert float(rows[-1]["change"]) == pytest.approx(np.linalg.norm(last.update.change[1]))
    assert np.array_equal(last.parameters, [record.parameters for record in training()][-1])


def test_tensorboard_reads_means_over_the_runs(tmp_path):
    pytest.importorskip("tensorboardX")
    from tensorboardX.proto.event_pb2 import Event

    records = list(watch(training(), TensorBoardLog(tmp_path, every=3)))
    (path,) = tmp_path.iterdir()
    content, found = path.read_bytes(), {}
    while content:  # a length, its checksum, an event, its checksum
        (length,) = struct.unpack("<Q", content[:8])
        event = Event.FromString(content[12 : 12 + length])
        found |= {(value.tag, event.step): value.simple_value for value in event.summary.value}
        content = content[16 + length :]
    assert {step for _, step in found} == {3, 6}
    assert {name.replace("/", "_") for name, _ in found} == set(quantities(records[0]))
    assert found["value/1", 6] == pytest.approx(records[-1].estimate.values[:, 1].mean(), rel=1e-6)


def test_an_observer_that_raises_is_left_out_aloud_and_the_training_goes_on():
    broken, sound = Noting(breaks_at=2), Noting()
    with pytest.warns(ObserverWarning, match="Noting raised OSError after episode 2: no space left"):
        records = list(watch(training(), broken, sound))
    assert [record.episode for record in records] == sound.seen == [1, 2, 3, 4, 5, 6]
    assert (broken.seen, broken.closed, sound.closed) == ([1, 2], 1, 1)


def test_a_training_that_is_left_closes_its_observers_and_can_be_saved(tmp_path):
    begun, noting = training(), Noting()
    for record in (records := watch(begun, noting)):
        if record.episode == 3:
            begun.save(tmp_path / "state.npz")
            break
    records.close()
    assert (noting.seen, noting.closed) == ([1, 2, 3], 1)


def test_what_is_no_observer_is_refused():
    with pytest.raises(ValueError, match="see\\(record\\) and close"):
        watch(training(), print)
    with pytest.raises(ValueError, match="every should be"):
        CsvLog("log.csv", every=0)


def test_bars_move_and_nothing_is_drawn_without_a_terminal(capsys):
    with ProgressBars({"a": 50, "b": 10}) as bars:
        bars.move("a", 30)
        assert [task.completed for task in bars.bars.tasks] == [30, 0]
    for _ in watch(training(), ProgressBar(6)):
        pass
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""
