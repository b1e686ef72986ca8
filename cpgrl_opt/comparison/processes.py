"""The parent's side of a worker process: orders go in, measurements come out, whatever happens to the process.

A solver may fork, and its children may hold the pipes of the process: it is always its whole group that ends.
"""

import contextlib
import ctypes
import os
import subprocess
import sys
import threading
import time
from time import monotonic
from typing import Any, Self

from ..isolation.process_group import ProcessGroup
from .judgement import CRASHED, HUNG
from .measurement import Measurement
from .worker import TIMING_BUDGET, Order, Refused, Started, c_library, receive, send, unanswered

_START_LIMIT = 600.0  # s on the wall for imports and, on a machine's first day, for compiling the default solver
_WALL_FACTOR = 4.0  # the CPU limit ends what computes; this many times it on the wall ends what sleeps
_WALL_ALLOWANCE = 2.0  # s on the wall
_TIMING = 3.0 * TIMING_BUDGET  # s of CPU for repeated calls after the answer, the default's among them
_LOOK_EVERY = 0.1  # s
_PROGRAM = "import sys; sys.path[:] = sys.argv[1:]; from cpgrl_opt.comparison.worker import serve; serve()"
# One thread each: CPU time counts all threads, and two workers share the cores.
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "RAYON_NUM_THREADS")
# A solver that prints λ makes noise; where the locale is C, it would seem to crash.
_ANY_TEXT = {"PYTHONIOENCODING": "utf-8:replace"}


class OrderRefused(ValueError):  # noqa: N818 - what happened
    """An order that no worker can carry out; the message says why."""


class WorkerProcess:
    """One process at a time, started when needed, replaced after a hang or a crash."""

    def __init__(self) -> None:
        self._group: ProcessGroup | None = None
        self._lock = threading.Lock()
        self._closed = False

    def carry_out(self, order: Order) -> Measurement:
        """The measurement; a hang or a crash of the process is one too. Raises OrderRefused, RuntimeError."""
        group = self._running()
        process: Any = group.process
        with contextlib.suppress(BrokenPipeError):
            send(process.stdin, order)
        with _Watch(group, cpu=_START_LIMIT, wall=_START_LIMIT):
            started = receive(process.stdout)
        if isinstance(started, Refused):
            raise OrderRefused(started.message)
        if not isinstance(started, Started):
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(1.0)
            self._discard()
            raise RuntimeError(
                f"a worker should start on {order.family} for {order.solver}; found it gone "
                f"(exit code {process.returncode}) before {order.solver} was called"
            )
        with _Watch(group, cpu=order.limit + _TIMING, wall=_WALL_FACTOR * order.limit + _WALL_ALLOWANCE) as watch:
            measurement = receive(process.stdout)
        if isinstance(measurement, Measurement):
            if watch.acted:  # killed as it answered: the next order needs another process
                self._discard()
            return measurement
        self._discard()
        return unanswered(order, started, HUNG if watch.acted else CRASHED)

    def close(self) -> None:
        """Ends the process for good; from another thread too, whose `carry_out` then raises RuntimeError."""
        with self._lock:
            self._closed = True
        self._discard()

    def _running(self) -> ProcessGroup:
        with self._lock:
            if self._closed:
                raise RuntimeError("the worker was closed")
            if self._group is None:
                environment = os.environ | dict.fromkeys(_ONE_THREAD, "1") | _ANY_TEXT
                self._group = ProcessGroup(
                    [sys.executable, "-c", _PROGRAM, *sys.path],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    env=environment,
                )
            return self._group

    def _discard(self) -> None:
        with self._lock:
            group, self._group = self._group, None
        if group is not None:
            group.kill()
            for stream in (group.process.stdin, group.process.stdout):
                with contextlib.suppress(OSError):
                    stream.close()  # type: ignore[union-attr]


class _Watch(threading.Thread):
    """Kills a group whose process has ended or used up its time; what reads from it then reads its end."""

    def __init__(self, group: ProcessGroup, *, cpu: float, wall: float) -> None:
        super().__init__(daemon=True)
        self.group, self.cpu, self.wall = group, cpu, wall
        self.acted = False
        self._over = threading.Event()

    def run(self) -> None:
        """Looks at both clocks ten times a second."""
        process = self.group.process
        start, used = monotonic(), cpu_seconds(process.pid)
        while not self._over.wait(_LOOK_EVERY):
            if process.poll() is not None:
                self.group.kill()  # what it forked keeps the pipe open
                return
            if monotonic() - start > self.wall or cpu_seconds(process.pid) - used > self.cpu:
                self.acted = True
                self.group.kill()
                return

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._over.set()
        self.join()


def cpu_seconds(pid: int) -> float:
    """CPU time that a process has used so far; 0 where the system does not tell (then only the wall clock counts)."""
    clock = ctypes.c_int()
    find: Any = getattr(c_library(), "clock_getcpuclockid", None)
    if find is None or find(pid, ctypes.byref(clock)) != 0:
        return 0.0
    try:
        return time.clock_gettime(clock.value)
    except OSError:  # it is gone
        return 0.0
