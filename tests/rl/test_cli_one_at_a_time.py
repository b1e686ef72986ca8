"""Two commands never write into one folder: the second exits, and says who holds it."""

import os
import signal
import time

import pytest
from typer.testing import CliRunner

from cpgrl_opt.comparison.folder_lock import LOCK
from rl.cli import app

TINY = ["--runs", "2", "--episodes", "20", "--steps", "20", "--record-every", "10", "--jobs", "1"]


def cpgrl(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.mark.skipif(os.name == "nt", reason="kills a process group")
def test_a_second_command_is_refused_until_the_first_is_gone(tmp_path, start_cpgrl, monkeypatch):
    monkeypatch.setattr("rl.experiments.runner.draw", lambda *_: None)
    endless = ["--runs", 2, "--episodes", 100_000_000, "--record-every", 10, "--jobs", 1]
    first = start_cpgrl("reproduce", "three-state", *endless, "--out", tmp_path)
    until = time.monotonic() + 300
    while not list(tmp_path.glob("*/learning.csv")) and first.poll() is None and time.monotonic() < until:
        time.sleep(0.05)
    for command in (
        ["reproduce", "three-state", *TINY, "--seed", 1],
        ["reproduce", "arm", "--runs", 1, "--episodes", 10, "--jobs", 1],
        ["compare", "--quick", "--solvers", "active-set", "--families", "zero-rows"],
    ):
        second = cpgrl(*command, "--out", tmp_path)
        assert second.exit_code == 2
        assert second.stderr.startswith(f"cpgrl: {tmp_path} is being written to by 'cli.py reproduce three-state")
        assert f"process {first.pid} on" in second.stderr
        assert second.stderr.count("\n") == 1
    assert {path.name.partition("-")[0] for path in tmp_path.iterdir()} == {"unfinished", LOCK.partition("-")[0]}
    os.killpg(first.pid, signal.SIGKILL)
    first.communicate(timeout=60)
    again = cpgrl("reproduce", "three-state", *TINY, "--out", tmp_path)
    assert again.exit_code == 0, again.stderr
    assert "summary.json" in {path.name for path in tmp_path.iterdir()}
    assert not (tmp_path / LOCK).exists()
