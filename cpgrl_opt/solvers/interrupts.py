"""Ctrl-C and the libraries in C that catch it themselves.

OSQP and SCS replace the handler of SIGINT while they run, and afterwards put back what they found. Two of them at once
may find each other's handler: then Ctrl-C does nothing for the rest of the process.
"""

import os
from collections.abc import Callable
from threading import Lock
from typing import Any

_one_at_a_time = Lock()


def run_alone(run: Callable[[], Any]) -> Any:
    """`run()`, one call at a time in this process. A Ctrl-C that the library caught is for the caller to pass on."""
    with _one_at_a_time:
        return run()


def _renew_lock() -> None:
    """A child that is forked while another thread solves would wait for that thread for ever."""
    global _one_at_a_time
    _one_at_a_time = Lock()


if hasattr(os, "register_at_fork"):  # there is no fork on Windows
    os.register_at_fork(after_in_child=_renew_lock)
