"""Ctrl-C and the libraries in C that catch it themselves."""

import _thread
import os
from collections.abc import Callable
from threading import Lock
from typing import Any

_one_at_a_time = Lock()


def run_alone(run: Callable[[], Any], was_interrupted: Callable[[Any], bool]) -> Any:
    """`run()`, one call at a time in this process; a Ctrl-C that the library caught is passed on to Python.

    OSQP and SCS replace the handler of SIGINT while they run, and afterwards put back what they found. Two of them at
    once may find each other's handler: then Ctrl-C does nothing for the rest of the process.
    """
    with _one_at_a_time:
        answer = run()
    if was_interrupted(answer):
        _thread.interrupt_main()
    return answer


def _renew_lock() -> None:
    """A child that is forked while another thread solves would wait for that thread for ever."""
    global _one_at_a_time
    _one_at_a_time = Lock()


if hasattr(os, "register_at_fork"):  # there is no fork on Windows
    os.register_at_fork(after_in_child=_renew_lock)
