"""What belongs to the whole process, and how to see that somebody changed it."""

import locale
import os
import random
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGALRM", "SIGSEGV") if hasattr(signal, name)]

# Each gives something that compares equal as long as nothing was changed.
_READ: dict[str, Callable[[], Any]] = {
    "NumPy's global generator": lambda: _comparable(np.random.get_state()),  # noqa: NPY002 - it is meant
    "Python's global generator": random.getstate,
    "np.geterr()": np.geterr,
    "np.geterrcall()": np.geterrcall,
    "np.get_printoptions()": np.get_printoptions,
    "the rounding of subnormal numbers to 0": lambda: float(np.float64(2.0**-1000) * np.float64(2.0**-60)),
    "warnings.filters": lambda: list(warnings.filters),
    "warnings.showwarning": lambda: warnings.showwarning,
    "sys.stdin, stdout or stderr": lambda: (id(sys.stdin), id(sys.stdout), id(sys.stderr)),
    "sys.excepthook": lambda: sys.excepthook,
    "the recursion limit": sys.getrecursionlimit,
    "the interval of thread switches": sys.getswitchinterval,
    "sys.path": lambda: list(sys.path),
    "os.environ": lambda: dict(os.environ),
    "the working folder": os.getcwd,
    "the locale": lambda: locale.setlocale(locale.LC_ALL),
    "a signal's handler": lambda: [signal.getsignal(number) for number in _SIGNALS],
}
_THREADS = "a thread that lives on"
# The import of a package at the first call may change these, once.
CHANGED_BY_IMPORTS = ("warnings.filters", "sys.path", "os.environ", "the recursion limit", _THREADS)


def snapshot() -> dict[str, Any]:
    """All of it, by name."""
    return {_THREADS: frozenset(threading.enumerate()), **{name: read() for name, read in _READ.items()}}


def changes_since(before: Mapping[str, Any]) -> list[str]:
    """The names of what is not as it was; of threads only new ones count."""
    after = snapshot()
    new = [_THREADS] if after[_THREADS] - before[_THREADS] else []
    return [*new, *(name for name in _READ if after[name] != before[name])]


@contextmanager
def restore_generators() -> Iterator[None]:
    """The global generators and the environment are as before afterwards: what takes long to save."""
    python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002 - the caller's
    environment = dict(os.environ)
    try:
        yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002
        for name in set(os.environ) - set(environment):
            del os.environ[name]
        os.environ.update(environment)


@contextmanager
def restore_process() -> Iterator[None]:
    """All else that can be put back is put back afterwards."""
    folder, path = os.getcwd(), list(sys.path)
    handlers = [(number, signal.getsignal(number)) for number in _SIGNALS]
    language, interval, limit = locale.setlocale(locale.LC_ALL), sys.getswitchinterval(), sys.getrecursionlimit()
    streams, hook = (sys.stdin, sys.stdout, sys.stderr), sys.excepthook
    try:
        with warnings.catch_warnings(), np.errstate(), np.printoptions():
            yield
    finally:
        os.chdir(folder)
        sys.path[:] = path
        _restore_handlers(handlers)
        locale.setlocale(locale.LC_ALL, language)
        sys.setswitchinterval(interval)
        sys.setrecursionlimit(limit)
        (sys.stdin, sys.stdout, sys.stderr), sys.excepthook = streams, hook


def _restore_handlers(handlers: list[tuple[Any, Any]]) -> None:
    """In the main thread, which alone may; None is a handler that was not installed from Python."""
    if threading.current_thread() is not threading.main_thread():
        return
    for number, handler in handlers:
        if handler is not None and signal.getsignal(number) is not handler:
            signal.signal(number, handler)


def _comparable(state: Any) -> tuple[Any, ...]:
    return (state[0], state[1].tobytes(), *state[2:])
