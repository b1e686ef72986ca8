"""The laws put to a solver in a process of its own: one that hangs, crashes, exits or prints ends that process only.

The process says what it is about to try before it tries it, so that the problem on which a solver never came back is
known to the end. After such a loss a new process goes on with the next law.
"""

import os
import pickle
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from time import monotonic
from typing import Any, BinaryIO, cast

import numpy as np

from ..isolation.process_group import ProcessGroup
from ..problem import DirectionProblem
from ..solvers import compile_kernels
from ..solvers.facts import tolerance_of
from .counterexample import counterexample_code
from .laws import LAWS, Law
from .subject import CannotCheck, Subject, load_subject
from .verdict import CheckResult, check_law

START_LIMIT = 300.0  # s, to import the solver's module, compile, and answer one problem
MOST_LOST = 3  # laws whose process was lost before the rest is given up
_LOOK_EVERY = 0.1  # s
_PROGRAM = "import sys; sys.path[:] = sys.argv[1:]; from cpgrl_opt.testing.isolation import serve; serve()"


@dataclass(frozen=True)
class Order:
    """What to check and how; expected: check → reason. time_limit: seconds that one problem may take."""

    target: str
    max_examples: int = 100
    seed: int = 0
    expected: tuple[tuple[str, str], ...] = ()
    time_limit: float = 30.0


@dataclass(frozen=True)
class Ready:
    """The solver is there; its tolerance."""

    tolerance: float
    imports: tuple[str, ...]
    expression: str


@dataclass(frozen=True)
class Trying:
    """A law is about to be put to the solver with these arguments."""

    check: str
    arguments: dict[str, Any]


@dataclass(frozen=True)
class Refused:
    """There is no solver to check."""

    message: str
    traceback: str


Message = Ready | Trying | Refused | CheckResult
Messages = Callable[[Order, Sequence[str]], Generator[Message, None, None]]


def examined_here(order: Order, checks: Sequence[str]) -> Generator[Message, None, None]:
    """Readiness and results, in this process: for solvers that are known to come back."""
    said: list[Message] = []
    _serve(order, checks, said.append)
    yield from (message for message in said if not isinstance(message, Trying))


def examined_apart(order: Order, checks: Sequence[str]) -> Generator[Message, None, None]:
    """Readiness and results, from as many processes as it takes."""
    remaining, lost, ready = list(checks), 0, None
    while remaining and lost < MOST_LOST:
        with _Worker(order, remaining) as worker:
            trying, tried = None, 0
            while remaining:
                message = worker.next_message(START_LIMIT if trying is None else order.time_limit)
                if isinstance(message, Trying):
                    trying, tried = message, tried + 1
                elif isinstance(message, Ready) and ready is None:
                    ready = message
                    yield message
                elif isinstance(message, Refused):
                    yield message
                    return
                elif isinstance(message, CheckResult):
                    trying, tried = None, 0
                    yield message
                    remaining.pop(0)
                elif message is None or isinstance(message, str):
                    loss = message or f"no answer within {order.time_limit:g} s"
                    if ready is None:
                        yield Refused(f"{order.target} should import and answer a problem; found {loss}", "")
                        return
                    yield _lost(order, remaining.pop(0), loss, ready, trying, tried)
                    lost += 1
                    break
    yield from (_not_run(order, check) for check in remaining)


class _Worker:
    """A process that serves an order, and its forks; what it prints goes to a file.

    Messages come through a pipe, which a fork may hold open for ever. So a thread looks at the process and the clock,
    and kills all of the group when either is over: whoever reads then finds the end.
    """

    def __init__(self, order: Order, checks: Sequence[str]) -> None:
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self._noise = Path(self._folder.name) / "output"
        self._group = ProcessGroup(
            [sys.executable, "-c", _PROGRAM, *sys.path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        self._deadline, self._was_late = float("inf"), False
        self._is_closed = threading.Event()
        self._watch = threading.Thread(target=self._watch_over, daemon=True)
        self._watch.start()
        with suppress(BrokenPipeError):  # it ended at once, which the first message says
            _send(self._pipe("stdin"), (order, list(checks), str(self._noise)))

    def next_message(self, limit: float) -> Message | str | None:
        """What the process says next; None if nothing within the limit, a text if it ended."""
        self._deadline = monotonic() + limit
        message: Message | None = _receive(self._pipe("stdout"))
        self._deadline = float("inf")
        if message is not None:
            return message
        self._group.kill()
        if self._was_late:
            return None
        written = self._noise.read_text(errors="replace").strip() if self._noise.exists() else ""
        last = f"; it last wrote: {written[-300:]}" if written else ""
        return f"the end of the process (exit code {self._group.process.returncode}){last}"

    def _watch_over(self) -> None:
        while not self._is_closed.wait(_LOOK_EVERY):
            self._was_late = monotonic() > self._deadline
            if self._was_late or self._group.process.poll() is not None:
                self._group.kill()
                return

    def _pipe(self, name: str) -> BinaryIO:
        return cast(BinaryIO, getattr(self._group.process, name))

    def __enter__(self) -> "_Worker":
        return self

    def __exit__(self, *_: object) -> None:
        self._is_closed.set()
        self._group.kill()
        self._watch.join()
        for name in ("stdin", "stdout"):
            with suppress(OSError):
                self._pipe(name).close()
        self._folder.cleanup()


def serve() -> None:
    """The process's main function: an order comes on stdin, messages go to what was stdout, output to a file."""
    channel = os.fdopen(os.dup(1), "wb")
    order, checks, noise = _receive(sys.stdin.buffer)
    nothing, target = os.open(os.devnull, os.O_RDONLY), os.open(noise, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(nothing, 0)
    for descriptor in (1, 2):
        os.dup2(target, descriptor)
    os.close(nothing)
    os.close(target)
    compile_kernels()  # of the oracle that the laws compare with: not in the solver's time
    _serve(order, checks, lambda message: _send(channel, message))


def _send(stream: BinaryIO, message: object) -> None:
    pickle.dump(message, stream)
    stream.flush()


def _receive(stream: BinaryIO) -> Any:
    """The next message; None where the other side is gone, in the middle of one too."""
    try:
        return pickle.load(stream)
    except (EOFError, OSError, pickle.UnpicklingError):
        return None


def _serve(order: Order, checks: Sequence[str], send: Callable[[Message], None]) -> None:
    try:
        subject = load_subject(order.target)
        tolerance = _declared_tolerance(order, subject)
        _require_packages(order, subject)
    except CannotCheck as error:
        send(Refused(error.message, error.traceback))
        return
    send(Ready(tolerance, subject.imports, subject.expression))
    reasons = dict(order.expected)
    for name in checks:
        result = check_law(
            _announced(LAWS[name], send),
            subject.solver,
            reason=reasons.get(name, ""),
            max_examples=order.max_examples,
            seed=order.seed,
            spelled=(subject.imports, subject.expression),
        )
        send(result)


def _declared_tolerance(order: Order, subject: Subject) -> float:
    """CannotCheck where the laws would be put to the solver with a tolerance that is none."""
    try:
        return tolerance_of(subject.solver)
    except ValueError as error:
        raise CannotCheck(f"{order.target}: {error}") from error


def _require_packages(order: Order, subject: Subject) -> None:
    """CannotCheck where a small problem shows that a package is missing; whatever else it shows is for the laws."""
    problem = DirectionProblem([1.0, 2.0], np.array([[1.0, 0.0]]))
    try:
        subject.solver.solve(problem)
    except ImportError as error:
        raise CannotCheck(f"{order.target} should have the packages that it needs; found {error}") from error
    except Exception:  # the laws will meet it again, and report it
        return


def _announced(law: Law, send: Callable[[Message], None]) -> Law:
    """The law, which says what it is about to try."""

    @wraps(law.check)
    def check(solver: Any, **arguments: Any) -> Any:
        send(Trying(law.name, arguments))
        return law.check(solver, **arguments)

    return replace(law, check=check)


def _lost(order: Order, check: str, loss: str, ready: Ready, trying: Trying | None, tried: int) -> CheckResult:
    """The result of a law on which the process was lost."""
    law, reason = LAWS[check], dict(order.expected).get(check, "")
    code, which = "", "It was lost before the law was put to a problem."
    if trying is not None:
        which = "The problem below is the first such, not the smallest."
        code = counterexample_code(
            law, None, trying.arguments, imports=ready.imports, spelled=ready.expression, remark=f"ends in {loss}"
        )
    return CheckResult(
        law.name,
        law.statement,
        run=max(tried, 1),
        expected=int(bool(reason)),
        failed=int(not reason),
        reason=reason,
        problem=f"solve should come back with a Direction; found {loss}. {which}",
        counterexample=code,
    )


def _not_run(order: Order, check: str) -> CheckResult:
    law = LAWS[check]
    problem = f"not run: the process was lost on {MOST_LOST} laws before."
    return CheckResult(law.name, law.statement, reason=dict(order.expected).get(check, ""), problem=problem)
