"""Ctrl-C during a compiled call is neither lost nor turned into another error."""

import os
import signal
import subprocess
import sys

import pytest

from cpgrl_opt.isolation.process_group import exit_on_termination
from rl.interrupts import InterruptsHeld

pytestmark = pytest.mark.usefixtures("hears_interrupts")


def test_an_interrupt_waits_for_the_end_of_the_block():
    reached = []

    def work():
        with InterruptsHeld():
            signal.raise_signal(signal.SIGINT)
            reached.append("the end")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert reached == ["the end"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interrupt_that_is_ignored_stays_ignored():
    previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with InterruptsHeld():
            signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, previous)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGHUP")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_request_to_end_waits_too_where_it_raises_and_ends_the_process_where_it_does_not(number):
    reached = []

    def work():
        with InterruptsHeld():
            signal.raise_signal(number)
            reached.append("the end")

    with pytest.raises(SystemExit) as ended, exit_on_termination():
        work()
    assert ended.value.code == 128 + number
    assert reached == ["the end"]
    with InterruptsHeld():
        assert signal.getsignal(number) == signal.SIG_DFL


def test_an_interrupt_that_ends_the_process_by_default_still_does():
    code = (
        "import signal; from rl.interrupts import InterruptsHeld\n"
        "signal.signal(signal.SIGINT, signal.SIG_DFL)\n"
        "with InterruptsHeld(): signal.raise_signal(signal.SIGINT); print('held', flush=True)\n"
        "print('survived')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode != 0
    assert done.stdout.split() == ["held"]
