"""Tasks in worker processes: answers in order, messages heard, failures raised, nobody left behind."""

import importlib
import operator
import os
import subprocess
import sys

import pytest

from cpgrl_opt.isolation.process_group import ProcessGroup
from rl.experiments.workers import WorkerDiedError, run_tasks

TASK = """
from itertools import count

def counted(item, report):  # (name, how far)
    name, last = item
    for k in count():
        report((name, k))
        if k == last:
            return name.upper()
"""


@pytest.fixture
def counted(tmp_path, monkeypatch):
    """A task that a worker can import, which loads less than a training."""
    (tmp_path / "task_of_a_test.py").write_text(TASK, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "task_of_a_test", raising=False)
    return importlib.import_module("task_of_a_test").counted


class Fatal:
    """Ends the process that unpickles it."""

    def __reduce__(self):
        return os._exit, (7,)


class Group:
    """The number of the group of the process that unpickles it."""

    def __reduce__(self):
        return os.getpgrp, ()


@pytest.fixture(autouse=True)
def no_process_is_left(monkeypatch):
    """Whatever a test does, its workers have ended."""
    started = []

    def start(*arguments, **settings):
        started.append(ProcessGroup(*arguments, **settings))
        return started[-1]

    monkeypatch.setattr("cpgrl_opt.isolation._process.ProcessGroup", start)
    yield
    assert all(group.process.returncode is not None for group in started)


def test_answers_come_in_the_order_of_the_items_and_reports_in_the_order_of_the_task(counted):
    heard = []
    answers = run_tasks(counted, [("a", 500), ("b", 3), ("c", 4)], heard.append, processes=2)
    assert answers == ["A", "B", "C"]
    for name, last in (("a", 500), ("b", 3), ("c", 4)):
        assert [k for item, k in heard if item == name] == list(range(last + 1))


def test_a_tasks_exception_is_raised_here():
    with pytest.raises(TypeError) as caught:
        run_tasks(operator.truediv, [1, 2], print, processes=2)  # a number by a function
    assert any("in another process" in note for note in caught.value.__notes__)


def test_a_worker_that_dies_is_an_error_not_a_hang():
    with pytest.raises(WorkerDiedError, match="exit code 7"):
        run_tasks(operator.is_, [Fatal(), Fatal()], print, processes=2)


def test_an_interrupt_of_the_listener_ends_the_workers(counted):
    def interrupt(report):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_tasks(counted, [("endless", None), ("endless too", None)], interrupt, processes=2)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no groups of processes")
def test_ctrl_c_does_not_reach_a_worker_not_even_one_that_is_still_starting():
    """A terminal sends it to the group of the command."""
    groups = run_tasks("{0}".format, [Group(), Group()], print, processes=2)
    assert len({str(os.getpgrp()), *groups}) == 3


ENDLESS = """
import os, re
from rl import map_runs
from rl.experiments.workers import run_tasks

def deaf(item, report):  # forks, reports nothing, and never lets go of Python's lock
    os.fork()
    os.write(2, b".")
    re.match("(a*)*b", "a" * 60)

def endless(share):
    os.write(2, b".")
    while True:
        pass

if __name__ == "__main__":
    import task_of_a_test
    CALL
"""
CALLS = {
    "run_tasks(task_of_a_test.deaf, [1, 2], print, processes=2)": 4,
    "map_runs(task_of_a_test.endless, 2, processes=2)": 2,
}


@pytest.mark.skipif(os.name == "nt", reason="kills with SIGKILL")
@pytest.mark.parametrize("call", CALLS)
def test_whoever_is_killed_leaves_no_worker_that_goes_on(call, tmp_path):
    (tmp_path / "task_of_a_test.py").write_text(ENDLESS.replace("CALL", call), encoding="utf-8")
    command = [sys.executable, "task_of_a_test.py"]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, start_new_session=True)
    assert process.stderr.read(CALLS[call]) == b"." * CALLS[call]
    process.kill()
    process.communicate(timeout=120)  # waits until nobody holds the pipe: all are gone


def test_what_a_task_prints_is_no_message(capfd):
    assert run_tasks(print, [1, 2], operator.not_, processes=2) == [None, None]
    assert "1 " in capfd.readouterr().err
