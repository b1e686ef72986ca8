"""Training tasks in worker processes that report while they run; the caller alone writes files and draws."""

import queue
from collections.abc import Callable, Sequence
from threading import Thread
from typing import Any, TypeVar

from cpgrl_opt.isolation import Isolated, IsolationError

Item = TypeVar("Item")
Result = TypeVar("Result")
Listener = Callable[[Any], None]
# task(item, report) → result; report(message) reaches the caller's listener, in order
Task = Callable[[Item, Listener], Result]
_NO_LIMIT = 1e9  # s, thirty years: a training takes as long as it takes


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
    waiting: queue.SimpleQueue[tuple[int, Item]] = queue.SimpleQueue()
    for each in enumerate(items):
        waiting.put(each)
    news: queue.SimpleQueue[tuple[Any, Any]] = queue.SimpleQueue()
    crew = [Isolated(task, time_limit=_NO_LIMIT, shows_output=True) for _ in range(min(processes, len(items)))]
    results: dict[int, Result] = {}
    try:
        for worker in crew:
            Thread(target=_work, args=(worker, waiting, news), daemon=True).start()
        while len(results) < len(items):
            kind, content = news.get()
            if kind == "report":
                listen(content)
            elif kind == "error":
                raise content
            elif kind != "idle":
                results[kind] = content
            elif meanwhile is not None:
                Thread(target=meanwhile, daemon=True).start()
                meanwhile = None
        return [results[position] for position in range(len(items))]
    finally:
        for worker in crew:
            worker.close()


def _work(worker: Isolated, waiting: "queue.SimpleQueue[Any]", news: "queue.SimpleQueue[tuple[Any, Any]]") -> None:
    """Has a worker do items until none is left; news are (position, result) and ("report" | "error" | "idle", …)."""
    try:
        while True:
            position, item = waiting.get_nowait()
            result = worker.apply(".__call__", item, listen=lambda message: news.put(("report", message)))
            if waiting.empty():
                news.put(("idle", None))
            news.put((position, result))
    except queue.Empty:
        return
    except IsolationError as lost:
        news.put(("error", WorkerDiedError(
            f"a worker process should answer or raise; found {lost}. With --jobs 1 everything runs in one process"
        )))  # fmt: skip
    except Exception as error:  # of the task: raised in the main thread
        news.put(("error", error))
