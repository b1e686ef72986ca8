"""Training tasks in worker processes that report while they run; the caller alone writes files and draws."""

from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from queue import SimpleQueue
from threading import Lock
from typing import Any, TypeVar

from cpgrl_opt.isolation import Isolated, IsolationError

Item = TypeVar("Item")
Result = TypeVar("Result")
Listener = Callable[[Any], object]
# task(item, report) → result; report(message) reaches the caller's listener, in order
Task = Callable[[Item, Listener], Result]
_NO_LIMIT = 1e9  # s, thirty years: a training takes as long as it takes


class WorkerDiedError(RuntimeError):
    """A worker process ended without an answer, killed or out of memory."""


def run_tasks(
    task: "Task[Item, Result]", items: Sequence[Item], listen: Listener, *, processes: int = 1
) -> list[Result]:
    """[task(item, report) for each item], in the order of the items, on up to `processes` worker processes.

    Parameters
    ----------
    task
        With one process it is called here. Otherwise task, items, messages and results are pickled.
    items
        What is done; the first ones begin first.
    listen
        Hears each message that a task reports, one at a time, in any thread.
    processes
        At most. No worker outlives the call, whatever ends it, nor this process if it is killed.

    Returns
    -------
    list
        The tasks' results.

    Raises
    ------
    WorkerDiedError
        Where a worker ends without an answer. What a task or `listen` raises is raised too.
    """
    count = min(processes, len(items))
    if count <= 1:
        return [task(item, listen) for item in items]
    crew = [Isolated(task, time_limit=_NO_LIMIT, shows_output=True) for _ in range(count)]
    free: SimpleQueue[Isolated] = SimpleQueue()
    for worker in crew:
        free.put(worker)
    one_at_a_time = Lock()

    def hear(message: Any) -> None:
        with one_at_a_time:
            listen(message)

    def work(item: Item) -> Any:
        worker = free.get()
        try:
            return worker.apply(".__call__", item, listen=hear)
        except IsolationError as lost:
            words = f"a worker process should answer or raise; found {lost}"
            raise WorkerDiedError(f"{words}. With --jobs 1 everything runs in one process") from lost
        finally:
            free.put(worker)

    with ThreadPoolExecutor(count) as pool:
        try:
            tasks = [pool.submit(work, item) for item in items]
            done, _ = wait(tasks, return_when=FIRST_EXCEPTION)
            for ended in done:
                ended.result()
            return [ended.result() for ended in tasks]
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in crew:
                worker.close()
