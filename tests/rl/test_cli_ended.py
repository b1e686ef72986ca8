"""Whatever ends `cpgrl compare`, nothing that it started goes on, and what was finished stays."""

import os
import select
import signal
import time

import pytest

from cpgrl_opt.comparison.folder_lock import LOCK
from cpgrl_opt.comparison.measurement import read_measurements

pytestmark = pytest.mark.skipif(os.name == "nt", reason="sends signals")

DEAF = """
import os, re, signal

class Deaf:
    def solve(self, problem):  # forks, and never lets go of Python's lock
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        os.fork()
        os.write(os.open(PIPE, os.O_WRONLY), b".")
        re.match("(a*)*b", "a" * 60)
"""


def read(pipe, count):
    """So many bytes, or b"" once nobody can write any more."""
    assert select.select([pipe], [], [], 120)[0], "nothing came, and somebody still holds the pipe"
    return os.read(pipe, count)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_comparison_that_is_ended_leaves_no_solver_that_goes_on(number, tmp_path, start_cpgrl, monkeypatch):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    (tmp_path / "deaf.py").write_text(DEAF.replace("PIPE", repr(str(tmp_path / "pipe"))), encoding="utf-8")
    pipe = os.open("pipe", os.O_RDONLY | os.O_NONBLOCK)
    chosen = ["--solvers", "active-set,deaf:Deaf", "--families", "zero-rows", "--problems", "1", "--jobs", "1"]
    process = start_cpgrl("compare", *chosen, "--out", "out")
    told = read(pipe, 1)
    told += read(pipe, 1)
    assert told == b".."
    measurements, until = tmp_path / "out" / "measurements.csv", time.monotonic() + 60
    while "active-set" not in measurements.read_text(encoding="utf-8") and time.monotonic() < until:
        time.sleep(0.01)  # the command writes while its workers go on
    os.kill(process.pid, number)
    _, errors = process.communicate(timeout=120)
    assert read(pipe, 1) == b"", "solver and fork are gone"
    os.close(pipe)
    is_asked = number == signal.SIGTERM
    assert process.returncode == (143 if is_asked else -9)
    assert ("Interrupted. out/measurements.csv holds every finished cell" in errors) == is_asked
    assert (tmp_path / "out" / LOCK).exists() != is_asked
    assert [each.solver for each in read_measurements(measurements)] == ["active-set"]
