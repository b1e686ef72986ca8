"""Tasks in worker processes: answers in order, messages heard, failures raised, nobody left behind."""

import importlib
import multiprocessing
import operator
import os
import signal
import sys
import threading

import pytest

from rl.experiments.three_state import Tick
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


class SignalsBlocked:
    """Those of the process that unpickles it, where it becomes their set."""

    def __reduce__(self):
        return signal.pthread_sigmask, (signal.SIG_BLOCK, ())


@pytest.fixture(autouse=True)
def no_process_is_left():
    """Whatever a test does, its workers end. Other tests' may live: joblib keeps some in reserve."""
    before = set(multiprocessing.active_children())
    yield
    left = set(multiprocessing.active_children()) - before
    for process in left:
        process.join(timeout=30)
    assert not any(process.is_alive() for process in left)


def test_answers_come_in_the_order_of_the_items_and_reports_in_the_order_of_the_task(counted):
    heard = []
    answers = run_tasks(counted, [("a", 500), ("b", 3), ("c", 4)], heard.append, processes=2)
    assert answers == ["A", "B", "C"]
    for name, last in (("a", 500), ("b", 3), ("c", 4)):
        assert [k for item, k in heard if item == name] == list(range(last + 1))


@pytest.mark.parametrize("processes", [1, 2])
def test_a_tasks_exception_is_raised_here(processes):
    with pytest.raises(TypeError) as caught:
        run_tasks(operator.truediv, [1, 2], print, processes=processes)  # a number by a function
    if processes == 2:
        assert any("in a worker process" in note for note in caught.value.__notes__)


def test_a_worker_that_dies_is_an_error_not_a_hang():
    with pytest.raises(WorkerDiedError, match="exit code 7"):
        run_tasks(operator.is_, [Fatal(), Fatal()], print, processes=2)


def test_an_interrupt_of_the_listener_ends_the_workers(counted):
    def interrupt(report):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_tasks(counted, [("endless", None), ("endless too", None)], interrupt, processes=2)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no mask of signals")
def test_ctrl_c_does_not_reach_a_worker_that_is_still_starting():
    blocked = run_tasks("{0}".format, [SignalsBlocked(), SignalsBlocked()], print, processes=2)
    assert all("SIGINT" in names for names in blocked), blocked
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_preparation_runs_once_beside_the_workers():
    done = threading.Event()
    run_tasks(operator.is_, [1, 2, 3], print, processes=2, meanwhile=done.set)
    assert done.wait(10)


def test_a_tick_tells_method_and_episode():
    assert Tick("cpgrl", 3) == Tick(label="cpgrl", episode=3)
