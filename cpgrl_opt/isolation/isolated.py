"""`Isolated`, an object in a process of its own, and `call`, a function in one.

Each call has a limit on the clock and, if asked for, one of processor time. At the limit, or when the process ends by
itself, it is killed with all that it started, and the call raises what happened; the next call starts another process.
"""

import os
import pickle
import threading
import weakref
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from numbers import Real
from operator import methodcaller
from statistics import median
from time import monotonic
from typing import Any, Self

from ._process import START_LIMIT, Process
from ._worker import pack
from .errors import AnswerError, CrashError, IsolationError, MemoryLimitError

_MOST_MEMORY = 2**62  # bytes: what a limit of the system's can hold, and more than there is
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
    shows_output
        Whether what it prints goes to this process's standard error, and not into a file that nobody else sees.

    Raises
    ------
    HangError, CrashError, MemoryLimitError, AnswerError
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
        shows_output: bool = False,
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
        self._environment, self._shows_output = dict(environment or {}), shows_output
        self._start = pickle.dumps(("start", (memory_limit, cloudpickle.dumps(make or (lambda: solver))), False))
        self._first: bytes | None = None
        self._process: Process | None = None
        self._lock = threading.RLock()
        self._is_closed = False

    def begin_with(self, function: Callable[[Any], Any]) -> None:
        """Have each process that starts call function(object) first, for which it has ten minutes.

        For what is slow once and should not count in a call: imports, compiling.
        """
        is_new, self._first = self._first is None, pack((function, (), False))
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
        order = pack((function, arguments, listen is not None))
        with self._lock:
            process = self._running()
            start = monotonic()
            try:
                kind, answer = process.ask(order, limit, cpu_limit, listen)
            except BaseException as lost:  # Ctrl-C too: its answer would be taken for that to the next order
                self._lose(lost)
                raise
            if kind == "answer":
                self._seconds.append(monotonic() - start)
                return answer
            if kind == "unsent":
                raise AnswerError(f"an answer that can be pickled should come back; found {answer}")
            if self.memory_limit is not None and isinstance(answer, MemoryError):
                raise MemoryLimitError(f"more memory than {self.memory_limit} bytes ({answer})") from answer
            raise answer

    def close(self) -> None:
        """End the process for good; from another thread too, in which a call then raises CrashError."""
        self._is_closed = True
        if (process := self._process) is not None:
            process.group.kill()  # whoever waits for its answer then lets the lock go
        with self._lock:
            if (process := self._process) is not None:
                process.end()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(f"Isolated offers what is public of its object; found {name!r}")
        is_method, value = self.apply("attribute", name)
        return partial(self._call_method, name) if is_method else value

    def _call_method(self, name: str, /, *arguments: Any, **settings: Any) -> Any:
        return self.apply(methodcaller(name, *arguments, **settings))

    def __repr__(self) -> str:
        if self._process is None or self._is_closed:
            return f"Isolated({'closed' if self._is_closed else 'not started'})"
        return f"Isolated({self.apply('.__repr__')})"

    def _running(self) -> Process:
        self._require_open()
        if self._process is None:
            self._process = process = Process(os.environ | _ANY_TEXT | self._environment, self._shows_output)
            self._finalizer = weakref.finalize(self, process.end)
            try:
                self._require_open()  # `close` may have looked for a process before there was one
                process.start(self._start, self._first)
            except BaseException as error:
                self._lose(error)
                raise
        return self._process

    def _require_open(self) -> None:
        if self._is_closed:
            raise CrashError("the end of the process, which was closed")

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
    """function(solver, *arguments), in the solver's own process where it is isolated.

    Parameters
    ----------
    function
        What can be imported by its name, where the solver is `Isolated`.
    solver, arguments
        Are handed over.

    Returns
    -------
    object
        The function's value.

    Raises
    ------
    IsolationError
        Where the process gave no answer.
    """
    return solver.apply(function, *arguments) if isinstance(solver, Isolated) else function(solver, *arguments)


def call(function: Callable[..., Any], *arguments: Any, time_limit: float, memory_limit: int | None = None) -> Any:
    """function(*arguments) in a process of its own.

    Parameters
    ----------
    function, arguments
        Whatever cloudpickle takes there.
    time_limit
        Seconds on the clock.
    memory_limit
        Bytes; None for as many as there are.

    Returns
    -------
    object
        The function's value.

    Raises
    ------
    HangError, CrashError, MemoryLimitError, AnswerError
        Where there is none. What the function itself raises is raised here too.
    """
    with Isolated(partial(function, *arguments), time_limit=time_limit, memory_limit=memory_limit) as room:
        return room.apply(".__call__")
