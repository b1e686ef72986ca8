"""The `cpgrl` command: names, exit codes, messages, and what Ctrl-C leaves."""

import json
import os
import signal
import time
from importlib.metadata import version

import pytest
from typer.testing import CliRunner

from cpgrl_opt import FORMULATIONS, SOLVERS
from rl import DivergenceError
from rl.cli import app
from rl.experiments.runner import files_of
from rl.experiments.three_state import METHODS, ThreeStateExperiment
from rl.experiments.workers import WorkerDiedError

FILES = files_of(ThreeStateExperiment)
COMPARISON = {name for name in FILES if name.startswith(("comparison", "tolerances"))}
TINY = ["--runs", "2", "--episodes", "20", "--steps", "20", "--record-every", "10", "--jobs", "1"]


def words(line):
    return line.split(",")


def cpgrl(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_version_is_the_packages():
    result = cpgrl("--version")
    assert result.exit_code == 0
    assert result.stdout == f"cpgrl {version('cpgrl-opt')}\n"


def test_solvers_lists_every_solver_with_what_it_takes_and_guarantees(monkeypatch):
    """The whole table, in the order of the registry, on a machine that has all packages but the one of highs."""
    monkeypatch.setattr("cpgrl_opt.solvers.packages.has_package", lambda package: package != SOLVERS["highs"].package)
    result = CliRunner().invoke(app, ["solvers"], env={"COLUMNS": "300"})
    assert result.exit_code == 0
    header, *rows = [
        [cell.strip() for cell in line.strip("┃│").replace("┃", "│").split("│")]
        for line in result.stdout.splitlines()
        if line[0] in "┃│"
    ]
    takes = {"rosen": "equality", "rosen-drop": "equality, cone"}
    assert header == ["solver", "installed", "formulations", "guarantee", "source"]
    assert len(rows) == len(SOLVERS)
    for row, (name, solver) in zip(rows, SOLVERS.items(), strict=True):
        installed, cases = "no" if name == "highs" else "yes", takes.get(name, ", ".join(FORMULATIONS))
        assert row == [name, installed, cases, solver.guarantee, solver.source]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    out = tmp_path_factory.mktemp("cli") / "new" / "results"
    out.mkdir(parents=True)
    (out / "notes.txt").write_text("mine", encoding="utf-8")
    (out / "claims.json").write_text("old", encoding="utf-8")
    return cpgrl("reproduce", "three-state", *TINY, "--record", 30, "--out", out), out


def test_a_small_reproduction_says_what_it_found_and_leaves_other_files(finished):
    result, out = finished
    assert result.exit_code == 0, result.output
    for words in ("claims hold", "steps/s", "subproblems.npz holds", str(out)):
        assert words in result.stdout.replace("\n", "")
    assert not result.stderr  # no progress bar without a terminal
    assert {path.name for path in out.iterdir()} == {*FILES, "notes.txt"} - COMPARISON
    assert (out / "notes.txt").read_text(encoding="utf-8") == "mine"
    assert isinstance(json.loads((out / "claims.json").read_text(encoding="utf-8")), list)


def test_strict_exits_with_1_when_a_claim_fails(tmp_path, monkeypatch):
    monkeypatch.setattr("rl.experiments.runner.draw", lambda *_: None)
    result = cpgrl("reproduce", "three-state", *TINY, "--out", tmp_path, "--strict")
    assert result.exit_code == 1
    assert "claims hold" in result.stdout
    assert not all(claim["holds"] for claim in json.loads((tmp_path / "claims.json").read_text(encoding="utf-8")))


@pytest.mark.parametrize(
    ("arguments", "near"),
    [
        (["reproduc"], "reproduce"),
        (["reproduce", "three-states"], "three-state"),
        (["reproduce", "three-state", "--solver", "rosn"], "rosen"),
        (["compare", "--families", "opposing-1e-44"], "opposing-1e-4"),
        (["compare", "--solvers", "activeset"], "active-set"),
        (["sweep", "three-state", "--engine", "lokky"], "loky"),
    ],
)
def test_a_wrong_name_is_answered_with_the_right_ones_and_the_nearest(arguments, near, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = cpgrl(*arguments)
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1  # one line, no traceback
    assert f"found {arguments[-1]!r}; the nearest is {near!r}" in result.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--runs", 10**12),
        ("--steps", 10**23),
        ("--jobs", -1),
    ],
)
def test_a_bad_number_is_answered_with_what_it_should_be(option, value, tmp_path):
    result = cpgrl("reproduce", "three-state", option, value, "--out", tmp_path / "out")
    assert result.exit_code == 2
    name = option.strip("-").replace("-", "_")
    assert result.stderr.startswith(f"cpgrl: {name} should be")
    assert result.stderr.rstrip().endswith(f"found {value}")
    assert not (tmp_path / "out").exists()


def test_a_solver_that_is_not_installed_says_what_to_type(tmp_path, monkeypatch):
    monkeypatch.setattr("cpgrl_opt.solvers.packages.has_package", lambda package: package != "daqp")
    result = cpgrl("reproduce", "three-state", *TINY, "--solver", "daqp", "--out", tmp_path)
    assert result.exit_code == 2
    assert "pip install 'cpgrl-opt[solvers]'" in result.stderr


def test_a_crash_leaves_what_was_recorded_and_says_so(tmp_path, monkeypatch):
    def crash(*_):
        raise RuntimeError("out of luck")

    monkeypatch.setattr("rl.experiments.three_state.ThreeStateExperiment.claims", crash)
    result = cpgrl("reproduce", "three-state", *TINY, "--out", tmp_path)
    assert isinstance(result.exception, RuntimeError)
    (place,) = tmp_path.iterdir()
    assert result.stderr == f"{place} keeps what was trained; the same command goes on from there.\n"
    assert (place / "learning.csv").read_text(encoding="utf-8").count("\n") == 1 + 4 * 2 * 3


FAILURES = [
    WorkerDiedError("a worker process should answer"),
    DivergenceError("θ[0] should be finite"),
    OSError("no space left"),
    MemoryError("8 TiB"),
]


@pytest.mark.parametrize("failure", FAILURES, ids=lambda failure: type(failure).__name__)
def test_what_is_no_bug_of_ours_is_one_line(tmp_path, monkeypatch, failure):
    def fail(*_, **__):
        raise failure

    monkeypatch.setattr("rl.experiments.runner.train", fail)
    result = cpgrl("reproduce", "three-state", *TINY, "--out", tmp_path)
    assert result.exit_code == 2
    assert str(failure) in result.stderr
    assert result.stderr.count("\n") == 1


def test_a_value_error_within_training_or_drawing_is_a_bug_and_keeps_its_traceback(tmp_path, monkeypatch):
    def broken(*_):
        raise ValueError("operands could not be broadcast")

    monkeypatch.setattr("rl.experiments.runner.draw", broken)
    result = cpgrl("reproduce", "three-state", *TINY, "--out", tmp_path)
    assert isinstance(result.exception, ValueError)


def test_ctrl_c_while_a_command_imports_is_one_line(monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("rl.experiments.solver_cases.cases", interrupt)
    result = cpgrl("solvers")
    assert (result.exit_code, result.stderr) == (130, "Interrupted.\n")


@pytest.mark.skipif(os.name == "nt", reason="SIGINT cannot be sent to a process on Windows")
@pytest.mark.parametrize(("number", "jobs"), [(signal.SIGTERM, "1"), (signal.SIGINT, "2")])
def test_ctrl_c_and_a_request_to_end_leave_what_was_recorded_and_say_so(tmp_path, jobs, number, start_cpgrl):
    (tmp_path / "claims.json").write_text("of an earlier run", encoding="utf-8")
    endless = ["--runs", 2, "--episodes", 100_000_000, "--record-every", 10]
    process = start_cpgrl("reproduce", "three-state", *endless, "--jobs", jobs, "--out", tmp_path)
    until = time.monotonic() + 300
    while time.monotonic() < until and process.poll() is None:
        if any(path.read_text(encoding="utf-8").count("\n") > 20 for path in tmp_path.glob("*/learning.csv")):
            break
        time.sleep(0.05)
    os.killpg(process.pid, number)  # as a terminal does, and `timeout`: to the group of the command
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + number, errors
    (place,) = tmp_path.glob("unfinished*")
    assert errors == f"Interrupted. {place} keeps what was trained; the same command goes on from there.\n"
    lines = (place / "learning.csv").read_text(encoding="utf-8").splitlines()[1:]
    found = [(METHODS.index(method), int(run), int(episode)) for method, run, episode, *_ in map(words, lines)]
    assert len(found) >= 20
    assert found == sorted(found)
    assert (tmp_path / "claims.json").read_text(encoding="utf-8") == "of an earlier run"
