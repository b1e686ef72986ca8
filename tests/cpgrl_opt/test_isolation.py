"""The kill table: what isolated code does, what the caller is told, and that nothing of it stays behind."""

import os
import select
import signal
import subprocess
import sys
import threading
import time

import pytest

from cpgrl_opt import SOLVERS, DirectionProblem
from cpgrl_opt.isolation import (
    AnswerError,
    CrashError,
    HangError,
    Isolated,
    MemoryLimitError,
    call,
    exit_on_termination,
)
from cpgrl_opt.isolation._process import Process

pytestmark = pytest.mark.skipif(os.name != "posix", reason="process groups are POSIX")

MISCONDUCT = """
import ctypes, os, re, signal, sys, threading, time

def hold():  # whoever is alive holds the named pipe
    os.open("held", os.O_WRONLY)

def sleep():
    time.sleep(600)

def loop():  # in C, with Python's lock held
    re.match("(a*)*b", "a" * 60)

def stop():
    os.kill(os.getpid(), signal.SIGSTOP)

def leave():
    raise SystemExit("bye")

def kill_supervisor():
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(600)

def segfault():
    ctypes.string_at(0)

def deaf():
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        signal.signal(number, signal.SIG_IGN)
    time.sleep(600)

def fork_and_loop():
    os.fork()
    loop()

def fork_and_fail():
    if os.fork() == 0:
        return
    time.sleep(0.2)  # the fork is the first to be done
    raise ValueError("of the parent")

def daemon_and_exit():
    if os.fork() == 0:
        os.setsid()
        if os.fork() == 0:
            deaf()
        os._exit(0)
    time.sleep(0.3)
    os._exit(7)

def daemon_and_stop():
    if os.fork() == 0:
        os.setsid()
        if os.fork() == 0:
            deaf()
        os._exit(0)
    stop()

def close_everything():
    os.closerange(3, 256)

def print_without_end():
    while True:
        print("x" * 100_000)

def eat():
    return bytearray(2**31)[0]

def fail():
    raise ValueError("broken")

def answer_a_lock():
    return threading.Lock()

class Leaving:
    def __reduce__(self):
        return sys.exit, ()

def answer_that_exits():
    return Leaving()

def report_without_end(_, report):
    while True:
        report("again")

def burn(_):
    while True:
        pass

def rest(_, *what):
    time.sleep(0.5)

def echo(_, what):
    return what

def stop_soon(_):
    threading.Timer(0.1, stop).start()

class Solver:
    tolerance = 1e-3

    def solve(self, act):
        hold()
        print(f"about to {act}")
        return globals()[act]()
"""
# what it does → (what is raised, words in the message)
KILL_TABLE = {
    "sleep": (HangError, r"no answer within 0.5 s; it was at File .*misconduct.py\", line 8 in sleep"),
    "fork_and_loop": (HangError, "in loop"),
    "print_without_end": (HangError, "in print_without_end"),
    "leave": (CrashError, r"\(exit code 1\); it last wrote: .*bye"),
    "segfault": (CrashError, r"\(signal SIGSEGV\); it was at .* in string_at, .* in segfault"),
    "daemon_and_exit": (CrashError, "exit code 7"),
    "daemon_and_stop": (HangError, "no answer within 0.5 s$"),
    "close_everything": (CrashError, "the end of the process"),
    "kill_supervisor": (CrashError, "signal SIGKILL"),
    "eat": (MemoryLimitError, "more memory than 1073741824 bytes"),
    "fail": (ValueError, "^broken\n"),
    "fork_and_fail": (ValueError, "^of the parent\n"),
    "answer_a_lock": (AnswerError, "can be pickled should come back; found lock, TypeError: cannot pickle"),
    "answer_that_exits": (AnswerError, "can be unpickled should come back; found SystemExit"),
}
NEEDS_LINUX = {"daemon_and_exit", "daemon_and_stop", "eat", "kill_supervisor"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("isolation")
    (folder / "misconduct.py").write_text(MISCONDUCT, encoding="utf-8")
    os.mkfifo(folder / "held")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.syspath_prepend(str(folder))
        yield folder


@pytest.fixture(scope="module")
def room(folder):
    import misconduct

    with Isolated(misconduct.Solver(), time_limit=0.5, memory_limit=2**30) as room:
        yield room


@pytest.fixture
def pipe(folder):
    descriptor = os.open(folder / "held", os.O_RDONLY | os.O_NONBLOCK)
    yield descriptor
    os.close(descriptor)


def is_held(pipe):
    """Whether a process still has the pipe open to write; waits a while for its end."""
    end = time.monotonic() + 20
    while time.monotonic() < end:
        if select.select([pipe], [], [], 0.1)[0] and os.read(pipe, 1) == b"":
            return False
    return True


@pytest.mark.parametrize("act", KILL_TABLE)
def test_whatever_it_does_has_a_name_and_leaves_nothing_and_the_next_call_is_answered(act, room, pipe):
    if act in NEEDS_LINUX and sys.platform != "linux":
        pytest.skip("Linux alone has what this needs")
    kind, words = KILL_TABLE[act]
    lost, threads = room.losses, threading.active_count()
    with pytest.raises(kind, match=words) as told:
        room.solve(act)
    assert room.losses - lost == (kind in (HangError, CrashError) or act == "answer_that_exits")
    if room.losses > lost:
        assert not is_held(pipe), "a process is left"
        assert threading.active_count() <= threads
    elif kind is not AnswerError:
        assert "in solve" in str(getattr(told.value.__cause__ or told.value, "__notes__", ""))
    assert room.tolerance == 1e-3


def test_a_limit_of_processor_time_is_one_of_work_and_not_of_sleep(room):
    import misconduct

    assert room.apply(misconduct.rest, cpu_limit=0.05, time_limit=60.0) is None
    with pytest.raises(HangError, match=r"0\.2 s of processor time; it was at .* in burn"):
        room.apply(misconduct.burn, cpu_limit=0.2, time_limit=60.0)


def test_what_reports_without_end_has_the_same_limits(room):
    import misconduct

    def listen(_):
        assert time.monotonic() < latest, "it goes on far beyond the limit"

    latest = time.monotonic() + 20
    with pytest.raises(HangError, match=r"no answer within 0.5 s; it was at .* in report_without_end"):
        room.apply(misconduct.report_without_end, listen=listen)


def test_what_is_sent_to_a_stopped_process_does_not_hold_the_caller(room):
    """A pipe takes 64 KiB; the stop comes from a thread, when the call before is over."""
    import misconduct

    room.apply(misconduct.stop_soon)
    time.sleep(0.3)
    with pytest.raises(HangError):
        room.apply(misconduct.rest, b"x" * 2**22)


def test_another_thread_may_end_it_in_the_midst_of_a_call(folder):
    import misconduct

    room = Isolated(misconduct.Solver(), time_limit=600.0)
    threading.Timer(1.0, room.close).start()
    for words in ("process", "was closed"):
        with pytest.raises(CrashError, match=words):
            room.solve("sleep")


def test_it_may_be_closed_while_it_starts(folder, monkeypatch):
    import misconduct

    room = Isolated(misconduct.Solver(), time_limit=2.0)
    usual = Process.__init__
    monkeypatch.setattr(Process, "__init__", lambda *settings: (room.close(), usual(*settings))[1])
    with pytest.raises(CrashError, match="was closed"):
        room.solve("sleep")


def test_after_ctrl_c_the_next_call_gets_its_own_answer(room, hears_interrupts):
    import misconduct

    threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        room.apply(misconduct.rest, time_limit=60.0)
    assert room.apply(misconduct.echo, 3, time_limit=60.0) == 3


def test_a_solver_looks_the_same_and_the_callers_process_is_not_touched(capfd):
    """What has no name to import by is taken along too."""
    problem = DirectionProblem([1.0, 2.0], [[0.0, 1.0]])
    before = sys.stdout, sys.stderr, signal.getsignal(signal.SIGTERM), threading.active_count()

    class Loud(type(SOLVERS["nnls"])):
        def solve(self, problem):
            sys.stdout.write("solving")
            return super().solve(problem)

    with Isolated(Loud(), time_limit=60.0) as solver:
        assert repr(solver) == "Isolated(not started)"
        alone, own = SOLVERS["nnls"].solve(problem), solver.solve(problem)
        assert (own.value.tobytes(), own.status) == (alone.value.tobytes(), alone.status)
        assert solver.supports(problem) is True
        assert solver.tolerance == SOLVERS["nnls"].tolerance
        assert not hasattr(solver, "session")
        assert "Loud" in repr(solver)
    assert repr(solver) == "Isolated(closed)"
    assert capfd.readouterr() == ("", "")
    assert (sys.stdout, sys.stderr, signal.getsignal(signal.SIGTERM), threading.active_count()) == before
    assert call(lambda x: x + 1, 2, time_limit=60.0, memory_limit=1e30) == 3  # a limit as one likes to write it


MAIN = """
from cpgrl_opt.isolation import Isolated
class Answer: pass
class Refusal(Exception): pass
def refuse(_, answer): raise Refusal("no")
class Solver:
    def solve(self, problem): return Answer()
with Isolated(Solver(), time_limit=60.0) as room:
    answer = room.solve(1)
    assert type(answer) is Answer
    try:
        room.apply(refuse, answer)
    except Refusal as refusal:
        print(refusal)
"""


def test_classes_and_functions_of_main_go_there_and_come_back():
    assert subprocess.check_output([sys.executable, "-c", MAIN], text=True).splitlines()[0] == "no"


@pytest.mark.parametrize("value", [0.0, float("inf"), "10", True])
def test_wrong_limits_and_nothing_to_isolate_are_refused(value):
    for name in ("time_limit", "memory_limit"):
        with pytest.raises(ValueError, match=rf"{name} should be a number of"):
            Isolated(SOLVERS["nnls"], **{name: value})
    with pytest.raises(ValueError, match="solver should be an object, or make a function"):
        Isolated()


CALLER = """
import os, sys, time
from cpgrl_opt.isolation import Isolated, exit_on_termination
import misconduct
with exit_on_termination():
    room = Isolated(misconduct.Solver(), time_limit=600.0)
    if sys.argv[2] == "exit":
        room.apply(misconduct.echo, 1)
        misconduct.hold()
        sys.exit(0)
    if "fork" in sys.argv[2]:
        room.apply(misconduct.echo, 1)
        if os.fork() == 0:
            time.sleep(600)
    room.solve(sys.argv[1])
"""


@pytest.mark.parametrize(
    ("act", "end"),
    [
        ("daemon_and_stop", "SIGKILL"),
        ("sleep", "SIGKILL beside a fork"),
        ("daemon_and_stop", "SIGHUP"),
        ("sleep", "exit"),
    ],
)
def test_whatever_ends_the_caller_ends_what_it_started(act, end, folder, pipe):
    if act in NEEDS_LINUX and sys.platform != "linux":
        pytest.skip("Linux alone has what this needs")
    caller = subprocess.Popen([sys.executable, "-c", CALLER, act, end], start_new_session=True)
    if end == "exit":
        assert caller.wait(60) == 0
    else:
        while not is_open(pipe):
            assert caller.poll() is None
        time.sleep(0.3)  # for the fork
        number = signal.Signals[end.split()[0]]
        caller.send_signal(number)
        assert caller.wait(60) == (-number if number == signal.SIGKILL else 128 + number)
    assert not is_held(pipe)
    if "fork" in end:
        os.killpg(caller.pid, signal.SIGKILL)


def is_open(pipe):
    """Whether some process has opened it to write."""
    try:
        os.read(pipe, 1)
    except BlockingIOError:
        return True
    time.sleep(0.05)
    return False


def test_signal_handlers_are_as_before_afterwards_and_those_of_others_stay():
    def mine(*_):
        pass

    def enter():
        with exit_on_termination():
            met.append(signal.getsignal(signal.SIGTERM))

    met, before = [], signal.signal(signal.SIGHUP, mine)
    try:
        with exit_on_termination():
            assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
            assert signal.getsignal(signal.SIGHUP) is mine
        thread = threading.Thread(target=enter)  # where Python lets nobody set handlers
        thread.start()
        thread.join()
    finally:
        signal.signal(signal.SIGHUP, before)
    assert met == [signal.getsignal(signal.SIGTERM)] == [signal.SIG_DFL]
