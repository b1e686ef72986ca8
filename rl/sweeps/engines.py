"""Where the trainings of a sweep run: joblib's backends loky (processes here), Dask and Ray."""

import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from cpgrl_opt.validation import require_count, require_member

from ..experiments.workers import WorkerDiedError
from ..parallel import end_with, run_under

Item = TypeVar("Item")
Result = TypeVar("Result")

_ROUND = 4  # tasks a worker between two looks at the results, where joblib cannot hand them over one by one


class MissingEngineError(ImportError):
    """The package of an engine is not installed; the message says what to type."""


def map_unordered(
    task: Callable[[Item], Result],
    items: Sequence[Item],
    died: Callable[[Item], Result],
    *,
    engine: str = "loky",
    jobs: int = 1,
) -> Iterator[Result]:
    """task(item) of each item, as they end.

    Parameters
    ----------
    task
        Pickled by value where it is a function of a script or of a notebook.
    died
        The result of an item whose process ended without an answer, also when it was alone; of loky's processes.
    engine
        "loky": processes of this machine, with one BLAS thread each, and with one job this process itself, which ends
        with a task that ends its process. "dask": the current `distributed.Client`, or a `LocalCluster` of `jobs`
        processes for the time of this call. "ray": the cluster that Ray is connected to, or one of `jobs` processes
        here.
    jobs
        Processes, where the cluster is not given.

    Raises
    ------
    ValueError
        For an unknown engine, or no job.
    MissingEngineError
        Where its package is missing.
    WorkerDiedError
        Where a process of loky ends that had nothing to do.
    """
    require_engine(engine, jobs)
    if engine != "loky":
        return _in_workers(task, items, engine, jobs)
    return map(task, items) if min(jobs, len(items)) <= 1 else _in_processes(task, items, died, jobs)


def _in_processes(
    task: Callable[[Any], Any], items: Sequence[Any], died: Callable[[Any], Any], jobs: int
) -> Iterator[Any]:
    """As long as none ends without an answer, beside each other; those that had begun then are repeated alone."""
    waiting = dict(enumerate(items))
    while waiting:
        with TemporaryDirectory() as folder:
            noting = partial(_note_begin, task, folder)
            try:
                for place, result in _in_workers(noting, [*waiting.items()], "loky", jobs):
                    del waiting[place]
                    yield result
            except BrokenProcessPool as error:
                begun = sorted({int(path.name) for path in Path(folder).iterdir()} & waiting.keys())
                if not begun:
                    words = "a worker process should answer or raise; one was killed that had nothing to do"
                    raise WorkerDiedError(f"{words}. What ended before is kept") from error
        for place in begun if waiting else ():
            item = waiting.pop(place)
            try:
                yield from _in_workers(task, [item], "loky", 2)  # joblib takes one job to be this process
            except BrokenProcessPool:
                yield died(item)


def _note_begin(task: Callable[[Any], Any], folder: str, numbered: tuple[int, Any]) -> tuple[int, Any]:
    """(number, task(item)); meanwhile the folder has a file of this number."""
    place, item = numbered
    begun = Path(folder, str(place))
    begun.touch()
    result = task(item)
    begun.unlink()
    return place, result


def _in_workers(task: Callable[[Any], Any], items: Sequence[Any], engine: str, jobs: int) -> Iterator[Any]:
    from joblib import Parallel, delayed, parallel_config

    with ExitStack() as stack:
        stack.enter_context(ENGINES[engine][1](jobs))
        chosen: dict[str, Any] = {"n_jobs": -1}  # as many as the cluster has
        if engine == "loky":
            chosen = {"n_jobs": jobs, "initializer": _leave_ctrl_c_to, "initargs": (os.getpid(),)}
            chosen["inner_max_num_threads"] = 1  # joblib would allow cores // jobs, and sums differ in their last bits
        stack.enter_context(parallel_config(backend=engine, **chosen))
        hand_over = Parallel(return_as="list")._backend.supports_return_generator
        workers = stack.enter_context(Parallel(return_as="generator_unordered" if hand_over else "list", batch_size=1))
        size = len(items) if hand_over else _ROUND * workers._effective_n_jobs()
        for start in range(0, len(items), size):
            yield from workers(delayed(run_under)(os.getpid(), task, item) for item in items[start : start + size])


def _leave_ctrl_c_to(parent: int) -> None:
    """A terminal sends it to all; the parent ends its workers, which would print a traceback each."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(parent)


@contextmanager
def _dask(jobs: int) -> Iterator[None]:
    from distributed import Client, LocalCluster, get_client

    with ExitStack() as stack:
        try:
            get_client()
        except ValueError:  # nobody is connected to a cluster
            cluster = LocalCluster(
                n_workers=jobs, threads_per_worker=1, dashboard_address=None, silence_logs=logging.ERROR
            )
            stack.enter_context(Client(stack.enter_context(cluster)))
        yield


@contextmanager
def _ray(jobs: int) -> Iterator[None]:
    import ray
    from ray.util.joblib import register_ray

    register_ray()
    is_ours = not ray.is_initialized()
    if is_ours:
        path = {"env_vars": {"PYTHONPATH": os.pathsep.join(sys.path)}}
        ray.init(
            num_cpus=jobs, include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR, runtime_env=path
        )
    try:
        yield
    finally:
        if is_ours:
            ray.shutdown()


# By name: the package, and where its workers come from.
ENGINES: dict[str, tuple[str, Callable[[int], AbstractContextManager[None]]]] = {
    "loky": ("joblib", lambda _: nullcontext()), "dask": ("distributed", _dask), "ray": ("ray", _ray),
}  # fmt: skip


def require_engine(engine: str, jobs: int) -> None:
    """What `map_unordered` raises, before anything is done.

    Parameters
    ----------
    engine, jobs
        As `map_unordered` says.

    Raises
    ------
    ValueError, MissingEngineError
        See there.
    """
    require_count("jobs", jobs)
    require_member("engine", engine, ENGINES)
    if find_spec(ENGINES[engine][0]) is None:
        words = f"engine {engine!r} needs a package that is not installed; type: pip install 'cpgrl-opt[{engine}]'"
        raise MissingEngineError(words)
