"""`cpgrl sweep`: what is swept, refused, interrupted and killed; and the engines that it runs on."""

import csv
import json
import os
import signal
import time

import pytest
from typer.testing import CliRunner

from rl import sweep
from rl.cli import app
from rl.sweeps.command import parse_seeds, parse_setting, train_case
from rl.sweeps.store import OUTCOMES, TABLE

SHORT = ["--over", "episodes=20", "--over", "steps=20", "--every", "10", "--jobs", "1"]
MINE = """
def broken(rate, seed):
    if seed == 1:
        raise RuntimeError("no robot")
    from rl.sweeps.command import train_case
    return train_case("three-state", step_size=rate, episodes=20, steps=20, seed=seed)
"""


def cpgrl(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_an_experiments_trainings_and_settings_are_swept(tmp_path, monkeypatch):
    monkeypatch.setattr("rl.sweeps.command.draw_curves", lambda *_: None)
    names = ["--over", "training=cpgrl,sum", "--over", "thresholds=[0,0,0],[-0.1,0,0]"]
    found = cpgrl("sweep", "three-state", *SHORT, *names, "--seeds", "3,5", "--out", tmp_path)
    assert found.exit_code == 0, found.output
    assert "Trained 8, of which 0 ended with an error." in found.stdout
    assert "Wrote sweep.csv, curves.csv, curves.png into" in found.stdout
    with (tmp_path / TABLE).open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [*rows[0]] == [
        "episodes", "steps", "training", "thresholds", "seed", "run", "episode", "channel", "value", "exact", "error"
    ]  # fmt: skip
    assert {(row["training"], tuple(json.loads(row["thresholds"])), row["seed"]) for row in rows} == {
        (training, thresholds, seed)
        for training in ("cpgrl", "sum") for thresholds in ((0, 0, 0), (-0.1, 0, 0)) for seed in ("3", "5")
    }  # fmt: skip
    *_, last = train_case("three-state", training="sum", thresholds=[-0.1, 0, 0], episodes=20, steps=20, seed=5)
    assert [float(row["value"]) for row in rows[-4:]] == last.estimate.values[0].tolist()
    assert "Trained 0," in cpgrl("sweep", "three-state", *SHORT, *names, "--seeds", "3,5", "--out", tmp_path).stdout
    anew = cpgrl("sweep", "three-state", *SHORT, "--seeds", "1", "--out", tmp_path, "--anew")
    assert "Trained 1," in anew.stdout
    assert len((tmp_path / OUTCOMES).read_text(encoding="utf-8").splitlines()) == 1


def test_a_function_of_ones_own_is_swept_and_what_breaks_is_told(tmp_path, monkeypatch):
    (tmp_path / "mine_of_a_test.py").write_text(MINE, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    found = cpgrl("sweep", "mine_of_a_test:broken", "--over", "rate=0.01", "--seeds", "2", "--jobs", 1, "--out", "o")
    assert found.exit_code == 1
    assert "Trained 2, of which 1 ended with an error." in found.stdout
    assert found.stderr == "rate 0.01, seed 1: RuntimeError: no robot (after episode 0)\n"
    assert (tmp_path / "o" / "curves.csv").exists()
    only = cpgrl("sweep", "mine_of_a_test:broken", "--over", "rate=0.01", "--seeds", "1,", "--jobs", 1, "--out", "o")
    assert "Wrote sweep.csv into o" in only.stdout
    assert not (tmp_path / "o" / "curves.csv").exists()
    assert not (tmp_path / "o" / "curves.png").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nothing"], "target should be one of three-state, arm, or MODULE:FUNCTION; found 'nothing'"),
        (["three-state", "--over", "steps=20", "--over", "steps=30"], "each name once"),
        (["no_such_module:f"], "No module named"),
        (["three-state", "--over", "solver"], "over should be name=value,value; found 'solver'"),
        (["three-state", "--over", "solver=rosn"], "solver should be one of"),
        (["three-state", "--over", "rate=1"], "a setting of three-state should be one of training, runs"),
        (["three-state", "--over", "episodes=20,20"], "settings should differ"),
        (["three-state", "--over", "training=all"], "training should be one of cpgrl"),
        (["three-state", "--over", f"steps={10**23}"], "steps should be an integer"),
        (["three-state", "--seeds", "few"], "seeds should be a number"),
    ],
)
def test_what_cannot_be_swept_is_one_line(arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = cpgrl("sweep", *arguments)
    assert (found.exit_code, found.stderr.count("\n")) == (2, 1)
    assert words in found.stderr
    assert not (tmp_path / "cpgrl-output").exists()


def test_an_engine_that_is_not_installed_says_what_to_type(tmp_path, monkeypatch):
    monkeypatch.setattr("rl.sweeps.engines.find_spec", lambda _: None)
    found = cpgrl("sweep", "three-state", *SHORT, "--engine", "ray", "--out", tmp_path)
    assert (found.exit_code, found.stderr.count("\n")) == (2, 1)
    assert "pip install 'cpgrl-opt[ray]'" in found.stderr


def test_values_are_json_or_words():
    assert parse_setting("a=0.1,2") == ("a", [0.1, 2])
    assert parse_setting("a = rosen, null,[1]") == ("a", ["rosen", None, [1]])
    assert (list(parse_seeds("3")), parse_seeds("3,")) == ([0, 1, 2], [3])


QUICK = """
import time
from types import SimpleNamespace
def quick(seed):
    time.sleep(0.05)
    yield SimpleNamespace(episode=1, parameters=[0.0], estimate=SimpleNamespace(values=[[float(seed)]]))
"""


@pytest.mark.skipif(os.name == "nt", reason="sends signals to a process group")
@pytest.mark.parametrize(
    ("signals", "codes"),
    # The second SIGTERM may come when Python has taken its own handlers down: then it ends the process by itself.
    [([signal.SIGINT], {130}), ([signal.SIGTERM, signal.SIGTERM], {143, -15}), ([signal.SIGKILL], {-9})],
    ids=["Ctrl-C", "SIGTERM twice", "SIGKILL"],
)
def test_what_ended_survives_and_no_worker_does(signals, codes, tmp_path, start_cpgrl, monkeypatch):
    (tmp_path / "quick_of_a_test.py").write_text(QUICK, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    process = start_cpgrl("sweep", "quick_of_a_test:quick", "--seeds", 10_000, "--jobs", 2, "--out", tmp_path)
    outcomes, until = tmp_path / OUTCOMES, time.monotonic() + 300
    while time.monotonic() < until and process.poll() is None:
        if outcomes.exists() and outcomes.read_bytes().count(b"\n") >= 5:
            break
        time.sleep(0.05)
    for number in signals:
        if number == signal.SIGINT:
            os.killpg(process.pid, number)  # as a terminal does
        else:
            process.send_signal(number)
        time.sleep(0.05)
    _, errors = process.communicate(timeout=120)  # waits until nobody holds the pipe: the workers are gone
    assert process.returncode in codes, errors
    assert errors.count("Interrupted.") == (-9 not in codes)
    assert "Traceback" not in errors
    ended = outcomes.read_bytes().count(b"\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    from quick_of_a_test import quick

    again = sweep(quick, [{}], seeds=20, out=tmp_path)
    assert again.trained <= 20 - min(ended, 15)
    assert not again.failed


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["dask", "ray"])
def test_clusters_make_the_same_bytes(engine, tmp_path):
    """A `LocalCluster` of Dask, a local one of Ray: some seconds each to start."""
    pytest.importorskip("distributed" if engine == "dask" else "ray")
    asked = ["sweep", "three-state", *SHORT[:4], "--over", "training=cpgrl,sum", "--seeds", 3, "--jobs", 2]
    for name in ("loky", engine):
        found = cpgrl(*asked, "--every", 5, "--engine", name, "--out", tmp_path / name)
        assert found.exit_code == 0, found.output
    for file in (TABLE, "curves.csv"):
        assert (tmp_path / "loky" / file).read_bytes() == (tmp_path / engine / file).read_bytes()
