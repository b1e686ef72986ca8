"""`cpgrl reproduce arm`: names, exit codes, messages, and what Ctrl-C leaves."""

import os
import signal
import time

import pytest
from typer.testing import CliRunner

from cpgrl_opt import FORMULATIONS, SOLVERS
from rl.cli import app
from rl.experiments.arm import CONDITIONS, ESTIMATORS
from rl.experiments.checkpoints import FOLDER

TINY = ["--runs", "1", "--episodes", "6", "--block", "3", "--jobs", "1"]


def cpgrl_arm(*arguments):
    return CliRunner().invoke(app, ["reproduce", "arm", *map(str, arguments)])


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    out = tmp_path_factory.mktemp("cli") / "new" / "results"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rl.experiments.runner.draw", lambda *_: None)
        return cpgrl_arm(*TINY, "--conditions", "c, a", "--compare", "--record", 8, "--out", out), out


def test_a_small_reproduction_prints_claims_comparison_speed_and_where_it_wrote(finished):
    result, out = finished
    assert result.exit_code == 0, result.output
    for text in (
        "claims hold",
        "The arm under each formulation",
        "M steps/s",
        "our additions",
        "subproblems.npz holds",
        "subproblems.npz leaves out b, linearized; c, linearized: problems of another shape.",  # no ridge
        str(out),
    ):
        assert text in result.stdout.replace("\n", ""), text
    for path in out.iterdir():
        assert path.name in result.stdout
    assert not result.stderr  # no progress bar without a terminal
    first = (out / "learning.csv").read_text(encoding="utf-8").splitlines()[1]
    assert first.startswith("a,0,3,")


def test_strict_exits_with_1_when_a_claim_fails(tmp_path, monkeypatch):
    monkeypatch.setattr("rl.experiments.runner.draw", lambda *_: None)
    assert cpgrl_arm(*TINY, "--conditions", "c", "--out", tmp_path, "--strict").exit_code == 1
    assert (tmp_path / "claims.json").exists()


@pytest.mark.parametrize(
    ("option", "value", "names"),
    [
        ("--conditions", "a,d", list(CONDITIONS)),
        ("--conditions", "", list(CONDITIONS)),
        ("--estimator", "kond", list(ESTIMATORS)),
        ("--solver", "rosn", list(SOLVERS)),
        ("--formulation", "cones", list(FORMULATIONS)),
    ],
)
def test_a_wrong_name_is_answered_with_the_right_ones(option, value, names, tmp_path):
    result = cpgrl_arm(option, value, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1  # one line, no traceback
    assert all(name in result.stderr for name in names)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("option", "value"),
    [("--runs", 0), ("--episodes", 0), ("--record-every", 0), ("--block", -1), ("--seed", -1), ("--jobs", -1)],
)
def test_a_bad_number_is_answered_with_what_it_should_be(option, value, tmp_path):
    result = cpgrl_arm(option, value, "--out", tmp_path / "out")
    assert result.exit_code == 2
    name = {"block": "record_every"}.get(option.strip("-"), option.strip("-").replace("-", "_"))
    assert result.stderr.startswith(f"cpgrl: {name} should be")
    assert result.stderr.rstrip().endswith(f"found {value}")
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(os.name == "nt", reason="SIGINT cannot be sent to a process on Windows")
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_ctrl_c_leaves_what_was_recorded_and_says_so(tmp_path, jobs, start_cpgrl):
    endless = ["--runs", 2, "--episodes", 100_000_000, "--block", 5]
    process = start_cpgrl("reproduce", "arm", *endless, "--jobs", jobs, "--out", tmp_path)
    path = tmp_path / "learning.csv"
    until = time.monotonic() + 180
    while time.monotonic() < until and process.poll() is None:
        if path.exists() and path.read_text(encoding="utf-8").count("\nb,") > 20:  # the longest goes first
            break
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to every process of the command
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "Interrupted" in errors
    assert "b to episode" in errors
    assert "Traceback" not in errors
    keys = [line.split(",")[:3] for line in path.read_text(encoding="utf-8").splitlines()[1:]]
    of_b = [(int(run), int(episode)) for condition, run, episode in keys if condition == "b"]
    assert len(of_b) >= 20
    assert of_b == sorted(of_b)
    assert {path.name for path in tmp_path.iterdir()} == {"learning.csv", FOLDER}
