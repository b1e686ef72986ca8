"""Training tasks in worker processes that report while they run; the caller alone writes files and draws."""

import multiprocessing
import pickle
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from threading import Thread
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
Listener = Callable[[Any], None]
# task(item, report) → result; report(message) reaches the caller's listener, in order
Task = Callable[[Item, Listener], Result]


class WorkerDiedError(RuntimeError):
    """A worker process ended without an answer, killed or out of memory."""


def run_tasks(
    task: "Task[Item, Result]",
    items: Sequence[Item],
    listen: Listener,
    *,
    processes: int = 1,
    meanwhile: Callable[[], object] | None = None,
) -> list[Result]:
    """[task(item, report) for each item], in the order of the items, on up to `processes` worker processes.

    With one process everything runs here. Workers are spawned, so task, items, messages and results are pickled;
    an exception of a task is raised here, and no worker outlives the call, whatever ends it. `meanwhile`, preparation
    for what follows, runs in a thread as soon as a worker, and with it a core, has nothing left to do.
    """
    if min(processes, len(items)) <= 1:
        return [task(item, listen) for item in items]
    crew: list[_Worker] = []
    try:
        for _ in range(min(processes, len(items))):
            crew.append(_Worker(task))
        return _shared_out(crew, items, listen, meanwhile)
    finally:
        for worker in crew:
            worker.end()


def _shared_out(
    crew: "list[_Worker]", items: Sequence[Any], listen: Listener, meanwhile: Callable[[], object] | None
) -> list[Any]:
    results: dict[int, Any] = {}
    waiting = list(enumerate(items))
    for worker in crew:
        worker.assign(*waiting.pop(0))
    while len(results) < len(items):
        for worker in _with_news(crew):
            kind, content = worker.receive()
            if kind == "report":
                listen(content)
                continue
            if kind == "error":
                raise content
            results[worker.position] = content
            if waiting:
                worker.assign(*waiting.pop(0))
                continue
            worker.busy = False
            if meanwhile is not None:
                Thread(target=meanwhile, daemon=True).start()
                meanwhile = None
    return [results[position] for position in range(len(items))]


def _with_news(crew: "list[_Worker]") -> "list[_Worker]":
    by_connection: dict[Any, _Worker] = {worker.connection: worker for worker in crew if worker.busy}
    return [by_connection[ready] for ready in wait(list(by_connection))]


class _Worker:
    """One process with a pipe to it; `position` is the index of the item that it is at."""

    def __init__(self, task: "Task[Any, Any]") -> None:
        context = multiprocessing.get_context("spawn")  # a fork would copy locks that other threads hold
        self.connection, far_end = context.Pipe()
        self.process: BaseProcess = context.Process(target=_serve, args=(task, far_end), daemon=True)
        with _interrupts_blocked():
            self.process.start()
        far_end.close()
        self.position, self.busy = -1, False

    def assign(self, position: int, item: Any) -> None:
        self.position, self.busy = position, True
        try:
            self.connection.send(item)
        except BrokenPipeError:
            raise self._death() from None

    def receive(self) -> tuple[str, Any]:
        try:
            message: tuple[str, Any] = self.connection.recv()
        except (EOFError, ConnectionResetError):
            raise self._death() from None
        return message

    def _death(self) -> WorkerDiedError:
        self.process.join(1.0)
        return WorkerDiedError(
            f"a worker process should answer or raise; it ended with exit code {self.process.exitcode}. "
            "With --jobs 1 everything runs in one process"
        )

    def end(self) -> None:
        self.process.terminate()
        self.process.join()
        self.connection.close()


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Ctrl-C waits till the end here, and for ever in a process started meanwhile: it inherits the mask.

    So a worker that is still importing does not print a traceback. Windows has no such mask.
    """
    if sys.platform == "win32":
        yield
        return
    resource_tracker.ensure_running()  # at the first start it would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(task: "Task[Any, Any]", connection: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the caller ends its workers
    while True:
        try:
            item = connection.recv()
        except EOFError:
            return
        try:
            answer = ("done", task(item, lambda message: connection.send(("report", message))))
        except Exception as error:  # handed over, raised there
            answer = ("error", _portable(error))
        connection.send(answer)


def _portable(error: Exception) -> Exception:
    """The exception with its traceback as a note; as a RuntimeError if it does not survive pickling."""
    trace = "in a worker process:\n" + "".join(traceback.format_exception(error))
    try:
        portable: Exception = pickle.loads(pickle.dumps(error))
    except Exception:  # an __init__ of other arguments than args
        portable = RuntimeError(f"{type(error).__name__}: {error}")
    portable.add_note(trace)
    return portable
