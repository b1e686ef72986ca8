"""Many runs on many cores: the same results in the same order, whatever the number of processes."""

import itertools
import os
from collections.abc import Callable, Sequence
from functools import cache
from threading import Thread
from time import sleep
from typing import TypeVar

from cpgrl_opt.validation import require_count

from .streams import run_indices

T = TypeVar("T")
Item = TypeVar("Item")


def map_runs(
    task: Callable[[Sequence[int]], T], runs: int | Sequence[int], *, processes: int = 1, threads: bool = False
) -> list[T]:
    """task(runs) of consecutive shares of the runs, one share for each process; results in the order of the runs.

    Since a run does not depend on those beside it, joining the results gives the same numbers for any `processes`.

    Parameters
    ----------
    task
        Usually drains `train(..., runs=share)` and returns arrays with a row for each run. An exception of it is
        raised here.
    runs
        How many, or which.
    processes
        With 1 the task runs here; otherwise in worker processes (joblib), for which it is pickled, and which end when
        this process does, killed or not.
    threads
        In threads instead, which share a core but for what the compiled kernels do.

    Returns
    -------
    list
        What the task returned for each share.

    Raises
    ------
    ValueError
        For numbers below 1 and runs that are none.
    """
    require_count("processes", processes)
    indices = run_indices(runs)
    shares = split(indices, processes)
    if len(shares) == 1:
        return [task(shares[0])]
    from joblib import Parallel, delayed

    workers = Parallel(n_jobs=len(shares), prefer="threads" if threads else "processes")
    return list(workers(delayed(run_under)(os.getpid(), task, share) for share in shares))


def run_under(parent: int, task: Callable[[Item], T], item: Item) -> T:
    """task(item), in a process that ends with `parent` if it is its child."""
    if os.getpid() != parent and os.getppid() == parent:
        end_with(parent)
    return task(item)


@cache
def end_with(parent: int) -> None:
    """Ends this process at most a second after its parent.

    joblib's workers do not look: one whose task never ends would go on for ever. On Windows it still does, since there
    a process keeps its parent's number after the parent's end.
    """

    def look() -> None:
        while os.getppid() == parent:
            sleep(1.0)
        os._exit(1)

    Thread(target=look, daemon=True).start()


def split(indices: Sequence[int], parts: int) -> list[Sequence[int]]:
    """Consecutive shares, as even as can be, none empty."""
    count = min(parts, len(indices))
    edges = [len(indices) * part // count for part in range(count + 1)]
    return [indices[start:end] for start, end in itertools.pairwise(edges)]
