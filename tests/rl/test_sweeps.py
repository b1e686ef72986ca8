"""A sweep is one tidy table, the same whatever it ran on, that goes on where it was stopped."""

import csv
import json
import os
import signal
import threading
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats

from cpgrl_opt import ConstrainedStep
from cpgrl_opt.comparison.folder_lock import FolderInUseError, locked_folder
from envs import ThreeStateMDP
from rl import CPGRL, GPOMDP, SoftmaxTable, Sweep, sweep, train
from rl.experiments.figure_style import blank_figure
from rl.sweeps import estimates
from rl.sweeps.cell import context_of, keys_of
from rl.sweeps.command import run_sweep
from rl.sweeps.curves import draw_curves, learning_curves

GRID = {"solver": ["rosen", "active-set"], "threshold": [-0.1, 0.0]}


@pytest.fixture
def training():
    """A function that workers get by value: they cannot import a file of tests."""

    def short(solver, threshold, seed):
        if (solver, threshold, seed) == ("rosen", 0.0, 1):
            raise RuntimeError("the environment\nbroke")
        learner = CPGRL(ConstrainedStep(solver=solver), [threshold] * 3)
        return train(ThreeStateMDP(), SoftmaxTable(3, 3), GPOMDP(steps=20), learner, episodes=25, runs=2, seed=seed)

    return short


@pytest.fixture
def counted(training):
    """The same here, and the calls of it."""
    calls = []

    def counting(**settings):
        calls.append(settings)
        return training(**settings)

    counting.calls = calls
    return counting


def read(folder):
    with (folder / "sweep.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_a_row_for_each_setting_seed_run_episode_and_channel_and_one_for_a_training_that_broke(training, tmp_path):
    found = sweep(training, GRID, seeds=[1, 4], every=10, out=tmp_path)
    keys = [tuple(row[name] for name in found.columns[:-2]) for row in found.rows if not row["error"]]
    assert keys == [
        (solver, threshold, seed, run, episode, channel)
        for solver in GRID["solver"] for threshold in GRID["threshold"] for seed in (1, 4)
        if (solver, threshold, seed) != ("rosen", 0.0, 1)
        for run in range(2) for episode in (10, 20, 25) for channel in range(4)
    ]  # fmt: skip
    (row,) = found.failed
    assert (row["solver"], row["threshold"], row["seed"], row["value"]) == ("rosen", 0.0, 1, "")
    assert row["error"] == "RuntimeError: the environment broke"
    *_, last = training("active-set", 0.0, 4)
    assert [row["value"] for row in found.rows[-4:]] == last.estimate.values[1].tolist()
    assert [{name: str(value) for name, value in row.items()} for row in found.rows] == read(tmp_path)


def test_two_processes_make_the_same_rows_but_of_a_training_that_ends_its_process(tmp_path):
    here = os.getpid()

    def deadly(seed):
        if os.getpid() != here:
            assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN, "the parent alone answers Ctrl-C"
            assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
            if seed == 0:
                os._exit(7)
        values = np.random.default_rng(seed).normal(size=(1, 4))
        yield SimpleNamespace(episode=1, parameters=[0.0], estimate=SimpleNamespace(values=values))

    one = sweep(deadly, [{}], seeds=3)
    two = sweep(deadly, [{}], seeds=3, jobs=2, out=tmp_path)
    first, *others = two.rows
    assert (first["seed"], first["error"].partition(":")[0]) == (0, "WorkerDiedError")
    assert others == one.rows[-len(others) :]
    assert {row["seed"] for row in others} == {1, 2}


def test_it_trains_only_what_is_new_and_what_failed(counted, tmp_path):
    first = sweep(counted, GRID, seeds=2, out=tmp_path)
    counted.calls.clear()
    again = sweep(counted, GRID, seeds=2, out=tmp_path)
    assert (again.rows, counted.calls) == (first.rows, [{"solver": "rosen", "threshold": 0.0, "seed": 1}])
    counted.calls.clear()
    sweep(counted, {"solver": ["active-set"], "threshold": [0.0, -0.2]}, seeds=[1], out=tmp_path)
    assert counted.calls == [{"solver": "active-set", "threshold": -0.2, "seed": 1}]
    assert sweep(counted, GRID, seeds=2, every=7, out=tmp_path).trained == 8


class SaysNothingError(Exception):
    def __str__(self):
        raise RuntimeError("no words")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (SystemExit(7), "SystemExit: 7"),
        (SaysNothingError(), f"{__name__}.SaysNothingError: <exception str() failed>"),
        (MemoryError(), "MemoryError"),
    ],
)
def test_whatever_a_training_raises_is_a_row_with_every_column(error, words):
    def broken(seed):
        raise error

    found = sweep(broken, [{}], seeds=1)
    empty = dict.fromkeys(("run", "channel", "value"), "")
    assert found.rows == found.failed == [{"seed": 0, "episode": 0, "error": words, **empty}]
    assert found.columns == ["seed", "run", "episode", "channel", "value", "error"]


def test_a_request_to_end_is_no_error_of_a_training():
    def ended(seed):
        raise SystemExit(143)

    with pytest.raises(SystemExit):
        sweep(ended, [{}], seeds=2)


class WithThreshold:
    """Trainings whose threshold is nobody's argument."""

    def __init__(self, threshold):
        self.threshold = threshold

    def train(self, seed):
        learner = CPGRL(ConstrainedStep(), [self.threshold] * 3)
        return train(ThreeStateMDP(), SoftmaxTable(3, 3), GPOMDP(steps=5), learner, episodes=1, runs=1, seed=seed)


def test_a_cell_is_known_by_all_that_its_numbers_depend_on(monkeypatch):
    def plain_key(training=None, measure=estimates, every=10, settings=None, seed=0):
        training = WithThreshold(0.0).train if training is None else training
        return keys_of({"rate": 1} if settings is None else settings, [seed], context_of(training, measure, every))[0]

    changed = [
        {"training": WithThreshold(0.1).train}, {"measure": lambda record: estimates(record)}, {"every": 11},
        {"settings": {"rate": 2}}, {"settings": {"step": 1}}, {"seed": 1},
    ]  # fmt: skip
    found = {plain_key(), *(plain_key(**own) for own in changed)}
    assert plain_key() in found
    with monkeypatch.context() as ours:
        ours.setattr("rl.digest.sources_digest", lambda: "other sources of ours")
        found.add(plain_key())
    monkeypatch.setattr("rl.sweeps.cell.versions", lambda packages: {"osqp": "osqp" in packages})
    found.add(plain_key())
    assert len(found) == len(changed) + 3


def test_a_line_that_a_killed_process_left_torn_is_trained_again(training, tmp_path):
    whole = sweep(training, GRID, seeds=2, out=tmp_path)
    outcomes = tmp_path / "outcomes.jsonl"
    first, *others = outcomes.read_bytes()[:-100].splitlines(keepends=True)
    spoilt = [b'{"key": "a", "episodes": null}\n', b'{"key": "a", "episodes": [5], "values": {"value": [3.0]}}\n']
    outcomes.write_bytes(b"".join([b"not ours\n", *spoilt, first, *others]))
    again = sweep(training, GRID, seeds=2, out=tmp_path)
    assert (again.rows, again.trained) == (whole.rows, 2)  # the torn one and the one that fails
    assert sweep(training, GRID, seeds=2, out=tmp_path).trained == 1


def test_other_measures_are_columns_and_other_settings_text(training):
    def measure(record):
        return {"value": record.estimate.values, "largest": np.abs(record.estimate.gradients).max(axis=2)}

    def listed(sizes, step, seed):
        return training("rosen", sizes[0], seed)

    found = sweep(listed, [{"sizes": (-0.1, 1), "step": ConstrainedStep()}], seeds=1, measure=measure)
    assert found.columns == ["sizes", "step", "seed", "run", "episode", "channel", "value", "largest", "error"]
    assert json.loads(found.rows[0]["sizes"]) == [-0.1, 1]
    assert json.loads(found.rows[0]["step"])[".drop"] == "'stationary'"
    assert all(row["largest"] > 0 for row in found.rows)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"settings": {"solver": []}}, "a list of values"),
        ({"settings": {"solver": "rosen"}}, "a list of values"),
        ({"settings": 3}, "dicts of the same names"),
        ({"every": 0}, "every should be"),
        ({"settings": [{"solver": "rosen"}, {"threshold": 0}]}, "dicts of the same names"),
        ({"settings": {"rate": [1]}}, "training should take rate, seed"),
        ({"settings": {"channel": [1]}}, "should not be named"),
        ({"settings": {"solver": ["rosen"], "threshold": [0, 0]}}, "settings should differ"),
        ({"settings": {"solver": [lambda: 1, lambda: 2], "threshold": [0]}}, "settings should differ"),
        ({"seeds": [1, 1]}, "seeds should be indices that differ"),
        ({"jobs": 0}, "jobs should be"),
        ({"engine": "spark"}, "engine should be one of loky, dask, ray"),
        ({"training": 3}, "training should be a function"),
        ({"out": "/dev/null/folder"}, "out should be a directory"),
    ],
)
def test_bad_input_is_refused(training, changed, words):
    asked = {"training": training, "settings": GRID, **changed}
    with pytest.raises(ValueError, match=words):
        sweep(asked.pop("training"), asked.pop("settings"), **asked)


@pytest.mark.parametrize(
    ("episodes", "measured", "words"),
    [
        (None, {}, "TypeError: 'NoneType' object is not iterable"),
        (0, {"value": [[1.0]]}, "one episode at least"),
        (1, {"value": [1.0]}, "measure should return arrays (1, channels)"),
        (1, {"seed": [[1.0]]}, "measure should have names of its own; found seed"),
    ],
)
def test_a_training_without_a_record_is_an_error_of_its_own(episodes, measured, words):
    def none(seed):
        if episodes is None:
            return None
        learner = CPGRL(ConstrainedStep(), [0.0] * 3)
        return train(ThreeStateMDP(), SoftmaxTable(3, 3), GPOMDP(), learner, episodes=episodes, runs=1, seed=seed)

    (row,) = sweep(none, {}, seeds=1, measure=lambda _: measured).rows
    assert words in row["error"]


def test_a_folder_has_one_writer_until_its_curves_are_drawn(training, tmp_path, monkeypatch):
    found = []

    def enter():
        with pytest.raises(FolderInUseError), locked_folder(tmp_path):
            pass
        found.append("refused")

    def ask(*_):
        thread = threading.Thread(target=enter)
        thread.start()
        thread.join()

    monkeypatch.setattr("rl.sweeps.command.draw_curves", ask)
    monkeypatch.setattr("rl.sweeps.command._function", lambda _: partial(training, "rosen", -0.1))
    run_sweep("a:function", [], tmp_path, seeds=[0], every=100, engine="loky", jobs=1, anew=False)
    assert found == ["refused"]


def test_curves_are_means_and_interquartile_means_with_intervals(training, tmp_path):
    found = sweep(training, GRID, seeds=[2, 3, 4, 5], every=25)
    curves = learning_curves(found)
    assert len(curves) == 4 * 1 * 4
    one = next(row for row in curves if (row["solver"], row["threshold"], row["channel"]) == ("rosen", -0.1, 1))
    taken = (row for row in found.rows if (row["solver"], row["threshold"], row["channel"]) == ("rosen", -0.1, 1))
    values = sorted(row["value"] for row in taken)
    assert one["runs"] == len(values) == 8
    assert one["mean"] == pytest.approx(np.mean(values))
    assert one["iqm"] == pytest.approx(np.mean(values[2:6]))
    for name in ("mean", "iqm"):
        again = scipy.stats.bootstrap(
            (values,), np.mean if name == "mean" else lambda x, axis: scipy.stats.trim_mean(x, 0.25, axis=axis),
            method="percentile", rng=np.random.default_rng(1), n_resamples=4000,
        ).confidence_interval  # fmt: skip
        length = again.high - again.low
        assert one[f"{name}_low"] == pytest.approx(again.low, abs=0.15 * length)
        assert one[f"{name}_high"] == pytest.approx(again.high, abs=0.15 * length)
    draw_curves(curves, tmp_path / "curves.png")
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="mean or iqm"):
        draw_curves(curves, tmp_path / "curves.png", "median")


def rows_of_runs(runs, settings):
    """A row for each setting and run, of values 0, 1, …."""
    columns = ["rate", "seed", "run", "episode", "channel", "value", "error"]
    listed = [
        (rate, seed, 0, 5, 0, float(seed), "") for rate in range(settings) for seed in range(runs[rate % len(runs)])
    ]
    return Sweep(columns, [dict(zip(columns, row, strict=True)) for row in listed], len(listed))


def test_settings_may_have_other_numbers_of_runs_and_a_figure_says_how_many_are_left_out(tmp_path, monkeypatch):
    curves = learning_curves(rows_of_runs([1, 3, 5], settings=10))
    assert [(row["runs"], row["mean"]) for row in curves[:3]] == [(1, 0.0), (3, 1.0), (5, 2.0)]
    assert [row["mean_low"] == row["iqm"] == row["iqm_high"] for row in curves[:3]] == [True, False, False]
    drawn = []

    def blank(*size):
        drawn.append(blank_figure(*size))
        return drawn[0]

    monkeypatch.setattr("rl.sweeps.curves.blank_figure", blank)
    draw_curves(curves, tmp_path / "curves.png")
    labels = [text.get_text() for text in drawn[0].legends[0].get_texts()]
    assert labels == [*(f"rate {rate}" for rate in range(8)), "… and 2 more in the table"]
