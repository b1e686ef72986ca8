"""`Isolated`, an object in a process of its own, and `call`, a function in one.

Each call has a limit on the clock and, if asked for, one of processor time. At the limit, or when the process ends by
itself, it is killed with all that it started, and the call raises what happened; the next call starts another process.
Nothing here waits for a pipe that somebody else may hold: a thread that nobody joins does.
"""

import ctypes
import os
import pickle
import queue
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from numbers import Real
from signal import Signals
from statistics import median
from time import monotonic
from typing import Any, BinaryIO, Self

from . import _worker
from .errors import CrashError, HangError, IsolationError, MemoryLimitError
from .process_group import ProcessGroup

START_LIMIT = 600.0  # s, for imports and, on a machine's first day, for compiling
_LOOK_EVERY = 0.05  # s: how late a limit is noticed
_TELLING = 0.3  # s, for the process to write where it is
_SHOWN = 4000  # the last characters of what it wrote that are looked at: a stack of frames is as long
_MOST_MEMORY = 2**62  # bytes: what a limit of the system's can hold, and more than there is
_MOST_OUTPUT = 2**26  # bytes, 64 MiB: a loop that prints fills a disk in a minute
_READ_AT_ONCE = 2**20  # bytes: a loop writes that much in some milliseconds
# Whoever prints λ would seem to crash where the locale is C.
_ANY_TEXT = {"PYTHONIOENCODING": "utf-8:replace"}


class Isolated:
    """An object, usually a solver, in a process of its own.

    `solve` and all other methods and attributes are those of the object. Arguments and answers are pickled. The process
    starts with the first call. Calls from several threads wait for each other. As a context, or by `close`, it ends;
    else with this object, and in any case with the process that made it.

    Parameters
    ----------
    solver
        The object, which `cloudpickle` takes to the process.
    make
        In place of it, what returns the object in each process that is started.
    time_limit
        Seconds on the clock that a call may take.
    memory_limit
        Bytes that the process may allocate; None for as many as there are. Only Linux keeps it.
    environment
        Variables that the process has besides this one's.
    is_heard
        Whether what it prints goes to this process's standard error, and not into a file that nobody else sees.

    Raises
    ------
    HangError, CrashError, MemoryLimitError
        By a call that got no answer. All are `IsolationError`. What the object itself raises is raised here too.
    """

    def __init__(
        self,
        solver: Any = None,
        *,
        make: Callable[[], Any] | None = None,
        time_limit: float = 30.0,
        memory_limit: int | None = None,
        environment: Mapping[str, str] | None = None,
        is_heard: bool = False,
    ) -> None:
        import cloudpickle  # takes what is defined in __main__, and functions of functions

        _require_positive("time_limit", "seconds", time_limit)
        if memory_limit is not None:
            _require_positive("memory_limit", "bytes", memory_limit)
            memory_limit = min(int(memory_limit), _MOST_MEMORY)
        if solver is None and not callable(make):
            raise ValueError(f"solver should be an object, or make a function that returns one; found {make!r}")
        self.time_limit, self.memory_limit = time_limit, memory_limit
        self.losses = 0  # processes that hung or crashed
        self._seconds: deque[float] = deque(maxlen=100)  # of the last calls that were answered
        self._environment, self._is_heard = dict(environment or {}), is_heard
        self._start = pickle.dumps(("start", (memory_limit, cloudpickle.dumps(make or (lambda: solver))), False))
        self._first: bytes | None = None
        self._process: _Process | None = None
        self._lock = threading.RLock()
        self._is_closed = False

    def begin_with(self, function: Callable[[Any], Any]) -> None:
        """Have each process that starts call function(object) first, for which it has ten minutes.

        For what is slow once and should not count in a call: imports, compiling.
        """
        is_new, self._first = self._first is None, pickle.dumps((function, (), False))
        if is_new and self._process is not None:
            self.apply(function, time_limit=START_LIMIT)

    @property
    def usual_seconds(self) -> float:
        """The median time of the last hundred calls that were answered; the limit where there was none."""
        return median(self._seconds) if self._seconds else self.time_limit

    def solve(self, problem: Any) -> Any:
        """What the object's method `solve` returns."""
        return self.apply(".solve", problem)

    def apply(
        self,
        function: Callable[..., Any] | str,
        *arguments: Any,
        time_limit: float | None = None,
        cpu_limit: float = 0.0,
        listen: Callable[[Any], None] | None = None,
    ) -> Any:
        """function(object, *arguments) in the process, which imports the function by its name; of ".name", the method.

        time_limit: seconds, in place of the usual; cpu_limit: of processor time, 0 for no such limit. listen: hears,
        here and meanwhile, what the function sends by the one more argument, report(message), that it then gets.
        """
        limit = self.time_limit if time_limit is None else time_limit
        order = pickle.dumps((function, arguments, listen is not None))
        with self._lock:
            process = self._running()
            start = monotonic()
            try:
                came_back, answer = process.ask(order, limit, cpu_limit, listen)
            except BaseException as lost:  # Ctrl-C too: its answer would be taken for that to the next order
                self._lose(lost)
                raise
            if came_back:
                self._seconds.append(monotonic() - start)
                return answer
            if self.memory_limit is not None and isinstance(answer, MemoryError):
                raise MemoryLimitError(f"more memory than {self.memory_limit} bytes ({answer})") from answer
            raise answer

    def close(self) -> None:
        """End the process for good; from another thread too, in which a call then raises CrashError."""
        self._is_closed = True
        process = self._process
        if process is not None:
            process.group.kill()
        with self._lock:
            if process is not None:
                process.end()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(f"Isolated offers what is public of its object; found {name!r}")
        is_method, value = self.apply("attribute", name)
        return partial(self.apply, f".{name}") if is_method else value

    def __repr__(self) -> str:
        return f"Isolated({self.apply('.__repr__')})"

    def _running(self) -> "_Process":
        if self._is_closed:
            raise CrashError("the end of the process, which was closed")
        if self._process is None:
            self._process = process = _Process(os.environ | _ANY_TEXT | self._environment, self._is_heard)
            self._finalizer = weakref.finalize(self, process.end)
            try:
                process.start(self._start, self._first)
            except BaseException as error:
                self._lose(error)
                raise
        return self._process

    def _lose(self, error: BaseException) -> None:
        self.losses += isinstance(error, IsolationError)
        process, self._process = self._process, None
        if process is not None:
            self._finalizer.detach()
            process.end()


def _require_positive(name: str, unit: str, value: Any) -> None:
    if isinstance(value, bool) or not isinstance(value, Real) or not 0 < float(value) < float("inf"):
        raise ValueError(f"{name} should be a number of {unit} > 0; found {value!r}")


def apply(function: Callable[..., Any], solver: Any, *arguments: Any) -> Any:
    """function(solver, *arguments), in the solver's own process where it is isolated."""
    return solver.apply(function, *arguments) if isinstance(solver, Isolated) else function(solver, *arguments)


def call(function: Callable[..., Any], *arguments: Any, time_limit: float, memory_limit: int | None = None) -> Any:
    """function(*arguments) in a process of its own, with the limits and errors of `Isolated`."""
    with Isolated(partial(function, *arguments), time_limit=time_limit, memory_limit=memory_limit) as room:
        return room.apply(".__call__")


class _Process:
    """One process, its pipes, the thread that waits for them, and the file of what it prints."""

    def __init__(self, environment: Mapping[str, str], is_heard: bool) -> None:
        self._output: BinaryIO = tempfile.TemporaryFile()  # noqa: SIM115 - `end` closes it
        self.group = ProcessGroup(
            [sys.executable, "-P", _worker.__file__, *sys.path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=None if is_heard else self._output,
            env=environment,
        )
        self._pid = 0
        self._orders: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._replies: queue.SimpleQueue[tuple[bool | None, Any] | None] = queue.SimpleQueue()
        process: Any = self.group.process
        exchange = self._orders, self._replies, process.stdin, process.stdout
        self._thread = threading.Thread(target=_exchange, args=exchange, daemon=True)
        self._thread.start()

    def start(self, *orders: bytes | None) -> None:
        """Has the object made, and whatever else comes first done. Raises what these do."""
        for order in orders:
            if order is not None:
                came_back, answer = self.ask(order, START_LIMIT)
                if not came_back:
                    raise answer
                self._pid = self._pid or answer

    def ask(
        self, order: bytes, time_limit: float, cpu_limit: float = 0.0, listen: Callable[[Any], None] | None = None
    ) -> tuple[bool | None, Any]:
        """(True, the answer to an order), or (False, the exception raised there). Raises HangError, CrashError."""
        self._orders.put(order)
        start, used = monotonic(), cpu_seconds(self._pid) if cpu_limit else 0.0
        is_over = False
        while True:
            try:
                reply = self._replies.get(timeout=_LOOK_EVERY)
                if reply is None or reply[0] is not None or listen is None:
                    break
                listen(reply[1])
                continue
            except queue.Empty:
                pass
            if is_over:  # somebody else holds its pipe
                reply = None
                break
            is_over = self.group.process.poll() is not None
            if monotonic() - start > time_limit:
                raise HangError(f"no answer within {time_limit:g} s{self._place()}")
            if cpu_limit and cpu_seconds(self._pid) - used > cpu_limit:
                raise HangError(f"no answer within {cpu_limit:g} s of processor time{self._place()}")
            if os.fstat(self._output.fileno()).st_size > _MOST_OUTPUT:
                os.ftruncate(self._output.fileno(), 0)  # who writes goes on where he was: a file with a hole
        if reply is None:
            raise CrashError(f"the end of the process ({self._end_in_words()}){self._last_words()}")
        return reply

    def end(self) -> None:
        """Ends the process and whatever it started."""
        self.group.kill()
        self._orders.put(None)
        self._thread.join(1.0)
        if not self._thread.is_alive():  # else somebody who cannot be killed holds a pipe
            for stream in (self.group.process.stdin, self.group.process.stdout):
                with suppress(OSError):
                    stream.close()  # type: ignore[union-attr]
        self._output.close()

    def _end_in_words(self) -> str:
        with suppress(subprocess.TimeoutExpired):
            self.group.process.wait(1.0)
        code = self.group.process.returncode
        if code is None or code >= 0:
            return f"exit code {code}"
        with suppress(ValueError):
            return f"signal {Signals(-code).name}"
        return f"signal {-code}"

    def _place(self) -> str:
        """Where it hangs: the frames that it writes on a signal, innermost first; nothing where it is stopped."""
        before = os.fstat(self._output.fileno()).st_size
        if _worker.WHERE is None or not self._pid:
            return ""
        with suppress(OSError):
            os.kill(self._pid, _worker.WHERE)
        text, end = "", monotonic() + _TELLING
        while monotonic() < end:
            time.sleep(0.01)
            size = min(os.fstat(self._output.fileno()).st_size, before + _READ_AT_ONCE)
            is_told = bool(_frames(text))  # by the turn before: now the last of them are there too
            # What it prints comes before and in between: unless the frames are in it, its end alone is kept.
            text, before = (text if is_told else text[-_SHOWN:]) + self._read(before, size), size
            if is_told:
                break
        return _frames(text)

    def _last_words(self) -> str:
        size = os.fstat(self._output.fileno()).st_size
        text = self._read(max(0, size - _SHOWN), size)
        if frames := _frames(text):  # of a crash in C
            return frames
        return f"; it last wrote: {' '.join(text[-_SHOWN // 4 :].split())}" if text.strip() else ""

    def _read(self, start: int, end: int) -> str:
        if not hasattr(os, "pread"):  # Windows; to seek would move the place where the process writes
            return ""
        return os.pread(self._output.fileno(), end - start, start).decode(errors="replace").strip("\0")


def _exchange(
    orders: "queue.SimpleQueue[bytes | None]",
    replies: "queue.SimpleQueue[tuple[bool | None, Any] | None]",
    stdin: BinaryIO,
    stdout: BinaryIO,
) -> None:
    """Sends each order and waits for its reply, until the other side is gone."""
    try:
        while (order := orders.get()) is not None:
            pickle.dump(order, stdin)
            stdin.flush()
            reply: tuple[bool | None, Any] = None, None
            while reply[0] is None:  # a report
                pickled = pickle.load(stdout)
                try:
                    reply = pickle.loads(pickled)
                except Exception as error:  # of a class that cannot be imported here
                    reply = False, error
                replies.put(reply)
    except Exception:  # an end in the middle of a message has many names
        replies.put(None)


def _frames(text: str) -> str:
    """The innermost frames of the stack that faulthandler wrote, but for those of `_worker`; "" for none."""
    lines = [line.strip() for line in text.splitlines() if line.startswith("  File ")]
    frames = [line for line in lines if _worker.__file__ not in line]
    return f"; it was at {', in '.join(frames[:3])}" if frames else ""


def cpu_seconds(pid: int) -> float:
    """CPU time that a process has used so far; 0 where the system does not tell (then only the wall clock counts)."""
    clock = ctypes.c_int()
    find: Any = getattr(_worker.c_library(), "clock_getcpuclockid", None)
    if find is None or find(pid, ctypes.byref(clock)) != 0:
        return 0.0
    try:
        return time.clock_gettime(clock.value)
    except OSError:  # it is gone
        return 0.0
