"""Whatever ends the parent ends what it started, forks and loops that hold Python's lock included."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from cpgrl_opt.comparison.process_group import ProcessGroup, exit_on_termination

pytestmark = pytest.mark.skipif(os.name != "posix", reason="kills process groups")

# Says that it is there, forks, and never ends: in C, with Python's lock held, and deaf to what can be ignored.
LOOP = """
import os, re, signal
for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
    signal.signal(number, signal.SIG_IGN)
os.fork()
os.write(1, b".")
re.match("(a*)*b", "a" * 60)
"""
PARENT = f"""
import sys
from cpgrl_opt.comparison.process_group import ProcessGroup, exit_on_termination
with exit_on_termination():
    group = ProcessGroup([sys.executable, "-c", {LOOP!r}], stdin=-3)
    try:
        sys.stdin.read()
    finally:
        if sys.argv[1] == "cleans up":
            group.kill()
            sys.stderr.write("cleaned up")
"""


def started(manners):
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, manners],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip
    assert parent.stdout.read(2) == b".."  # the process and its fork
    return parent


def last_words(parent):
    """Lets the parent end, and returns only once nobody holds the pipes: all are gone. Else TimeoutExpired."""
    return parent.communicate(timeout=120)[1].decode()


@pytest.mark.parametrize("to_group", [False, True])
def test_a_killed_parent_takes_everything_with_it(to_group):
    parent = started("leaves it")
    (os.killpg if to_group else os.kill)(parent.pid, signal.SIGKILL)
    parent.wait(120)
    assert last_words(parent) == ""
    assert parent.returncode == -signal.SIGKILL


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_parent_that_is_asked_to_end_cleans_up_and_says_by_what_it_ended(number):
    parent = started("cleans up")
    parent.send_signal(number)
    parent.wait(120)
    assert last_words(parent) == "cleaned up"
    assert parent.returncode == 128 + number


def test_a_parent_that_forgets_its_group_takes_it_along_as_well():
    parent = started("leaves it")
    assert last_words(parent) == ""
    assert parent.returncode == 0


def test_killing_a_group_ends_the_forks_and_leaves_the_exit_code_of_the_process():
    read, write = os.pipe()
    code = "import os, time\nif os.fork() == 0:\n    time.sleep(600)\nos._exit(7)"
    group = ProcessGroup([sys.executable, "-c", code], stdin=subprocess.DEVNULL, stdout=write)
    os.close(write)
    group.process.wait(120)
    group.kill()
    assert os.read(read, 1) == b""  # the fork, which held the other end, is gone
    os.close(read)
    group.kill()
    assert group.process.returncode == 7


def test_signal_handlers_are_as_before_afterwards_and_others_stay():
    def mine(*_):
        pass

    before = signal.signal(signal.SIGHUP, mine)
    try:
        with exit_on_termination():
            assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
            assert signal.getsignal(signal.SIGHUP) is mine
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)


def test_in_another_thread_signals_are_left_alone():
    entered = []

    def enter():
        with exit_on_termination():
            entered.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert entered == [signal.SIG_DFL]
