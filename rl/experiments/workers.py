"""Training tasks in worker processes that report while they run; the caller alone writes files and draws."""

import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import traceback
from collections.abc import Callable, Sequence
from threading import Thread
from typing import Any, BinaryIO, TypeVar

from cpgrl_opt.isolation.process_group import ProcessGroup

Item = TypeVar("Item")
Result = TypeVar("Result")
Listener = Callable[[Any], None]
# task(item, report) → result; report(message) reaches the caller's listener, in order
Task = Callable[[Item, Listener], Result]
News = tuple["_Worker", str, Any]
_PROGRAM = "import sys; sys.path[:] = sys.argv[1:]; from rl.experiments.workers import serve; serve()"


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

    With one process everything runs here. Otherwise task, items, messages and results are pickled, and an exception of
    a task is raised here. No worker outlives the call, whatever ends it, nor this process if it is killed. `meanwhile`,
    preparation for what follows, runs in a thread as soon as a worker, and with it a core, has nothing left to do.
    """
    if min(processes, len(items)) <= 1:
        return [task(item, listen) for item in items]
    crew: list[_Worker] = []
    news: queue.SimpleQueue[News] = queue.SimpleQueue()
    try:
        for _ in range(min(processes, len(items))):
            crew.append(_Worker(task, news))
        return _shared_out(crew, news, items, listen, meanwhile)
    finally:
        for worker in crew:
            worker.end()


def _shared_out(
    crew: "list[_Worker]",
    news: "queue.SimpleQueue[News]",
    items: Sequence[Any],
    listen: Listener,
    meanwhile: Callable[[], object] | None,
) -> list[Any]:
    results: dict[int, Any] = {}
    waiting = list(enumerate(items))
    for worker in crew:
        worker.assign(*waiting.pop(0))
    while len(results) < len(items):
        worker, kind, content = news.get()
        if kind == "report":
            listen(content)
            continue
        if kind == "gone":
            raise worker.death()
        if kind == "error":
            raise content
        results[worker.position] = content
        if waiting:
            worker.assign(*waiting.pop(0))
        elif meanwhile is not None:
            Thread(target=meanwhile, daemon=True).start()
            meanwhile = None
    return [results[position] for position in range(len(items))]


class _Worker:
    """One process with pipes to it; `position` is the index of the item that it is at.

    What it says goes into `news`: (itself, "report" | "done" | "error" | "gone", content).
    """

    def __init__(self, task: "Task[Any, Any]", news: "queue.SimpleQueue[News]") -> None:
        # Its group is not the terminal's: Ctrl-C does not reach it, not even while it is still importing.
        command = [sys.executable, "-c", _PROGRAM, *sys.path]
        self.group = ProcessGroup(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.process: Any = self.group.process
        self.position = -1
        self.reader = Thread(target=self._read, args=(news,), daemon=True)
        self.reader.start()
        self._send(task)

    def assign(self, position: int, item: Any) -> None:
        self.position = position
        self._send(item)

    def death(self) -> WorkerDiedError:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(1.0)
        return WorkerDiedError(
            f"a worker process should answer or raise; it ended with exit code {self.process.returncode}. "
            "With --jobs 1 everything runs in one process"
        )

    def end(self) -> None:
        self.group.kill()
        self.reader.join(1.0)
        if not self.reader.is_alive():  # else somebody who left the group holds the pipe
            self.process.stdout.close()
        with contextlib.suppress(OSError):
            self.process.stdin.close()

    def _send(self, message: object) -> None:
        try:
            _write(self.process.stdin, message)
        except OSError:  # a broken pipe
            raise self.death() from None

    def _read(self, news: "queue.SimpleQueue[News]") -> None:
        while True:
            try:
                kind, content = pickle.load(self.process.stdout)
            except (EOFError, pickle.UnpicklingError, OSError):
                return news.put((self, "gone", None))
            except Exception as error:  # of what it sent: raised in the main thread
                return news.put((self, "error", error))
            news.put((self, kind, content))


def _write(stream: BinaryIO, message: object) -> None:
    stream.write(pickle.dumps(message))  # whole, or not at all where it cannot be pickled
    stream.flush()


def serve() -> None:
    """The main function of a worker: does items of a task until its caller is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the caller ends its workers
    incoming, outgoing = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a task prints is no message
    with contextlib.suppress(EOFError, BrokenPipeError):
        task = pickle.load(incoming)
        while True:
            item = pickle.load(incoming)
            try:
                answer = ("done", task(item, lambda message: _write(outgoing, ("report", message))))
            except Exception as error:  # handed over, raised there
                answer = ("error", _portable(error))
            _write(outgoing, answer)


def _portable(error: Exception) -> Exception:
    """The exception with its traceback as a note; as a RuntimeError if it does not survive pickling."""
    trace = "in a worker process:\n" + "".join(traceback.format_exception(error))
    try:
        portable: Exception = pickle.loads(pickle.dumps(error))
    except Exception:  # an __init__ of other arguments than args
        portable = RuntimeError(f"{type(error).__name__}: {error}")
    portable.add_note(trace)
    return portable
