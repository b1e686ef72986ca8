"""The laws put to a solver in a process of its own: one that hangs, crashes, exits or prints ends that process only.

The process says what it is about to try before it tries it, so that the problem on which a solver never came back is
known to the end. After such a loss a new process goes on with the next law.
"""

import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np

from ..problem import DirectionProblem
from ..solvers import compile_kernels
from ..solvers.interface import tolerance_of
from .counterexample import counterexample_code
from .laws import LAWS, Law
from .subject import CannotCheck, Subject, load_subject
from .verdict import CheckResult, check_law

START_LIMIT = 300.0  # s, to import the solver's module, compile, and answer one problem
MOST_LOST = 3  # laws whose process was lost before the rest is given up


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
Messages = Callable[[Order, Sequence[str]], Iterator[Message]]


def examined_here(order: Order, checks: Sequence[str]) -> Iterator[Message]:
    """Readiness and results, in this process: for solvers that are known to come back."""
    said: list[Message] = []
    _serve(order, checks, said.append)
    yield from (message for message in said if not isinstance(message, Trying))


def examined_apart(order: Order, checks: Sequence[str]) -> Iterator[Message]:
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
    """A process that serves an order; what it prints goes to a file."""

    def __init__(self, order: Order, checks: Sequence[str]) -> None:
        context = get_context("spawn")
        self._connection, theirs = context.Pipe(duplex=False)
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self._noise = Path(self._folder.name) / "output"
        self._process: BaseProcess = context.Process(
            target=_serve_quietly, args=(order, list(checks), theirs, str(self._noise))
        )
        self._process.start()
        theirs.close()

    def next_message(self, limit: float) -> Message | str | None:
        """What the process says next; None if nothing within the limit, a text if it ended."""
        if not self._connection.poll(limit):
            return None
        try:
            message: Message = self._connection.recv()
        except EOFError:
            self._process.join()
            written = self._noise.read_text(errors="replace").strip() if self._noise.exists() else ""
            last = f"; it last wrote: {written[-300:]}" if written else ""
            return f"the end of the process (exit code {self._process.exitcode}){last}"
        return message

    def __enter__(self) -> "_Worker":
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()
        self._process.kill()
        self._process.join()
        self._folder.cleanup()


def _serve_quietly(order: Order, checks: Sequence[str], connection: Connection, noise: str) -> None:
    """The process's main function: output goes to the file `noise`, messages to the connection."""
    target = os.open(noise, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    for descriptor in (1, 2):
        os.dup2(target, descriptor)
    os.close(target)
    compile_kernels()  # of the oracle that the laws compare with: not in the solver's time
    _serve(order, checks, connection.send)


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
