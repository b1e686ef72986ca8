"""Many runs on many cores: the same results in the same order, whatever the number of processes."""

import itertools
from collections.abc import Callable, Sequence
from typing import TypeVar

from .policies.interface import require_count
from .streams import run_indices

T = TypeVar("T")


def map_runs(
    task: Callable[[Sequence[int]], T], runs: int | Sequence[int], *, processes: int = 1, threads: bool = False
) -> list[T]:
    """task(runs) of consecutive shares of the runs, one share for each process; results in the order of the runs.

    task: usually drains `train(..., runs=share)` and returns arrays with a row for each run; since a run does not
    depend on those beside it, joining the results gives the same numbers for any `processes`. With processes = 1 it
    runs here; otherwise in worker processes (joblib), for which it is pickled; `threads`: in threads instead, which
    share a core but for what the compiled kernels do. An exception of a task is raised here.
    """
    require_count("processes", processes)
    indices = run_indices(runs)
    shares = split(indices, processes)
    if len(shares) == 1:
        return [task(shares[0])]
    from joblib import Parallel, delayed

    workers = Parallel(n_jobs=len(shares), prefer="threads" if threads else "processes")
    return list(workers(delayed(task)(share) for share in shares))


def split(indices: Sequence[int], parts: int) -> list[Sequence[int]]:
    """Consecutive shares, as even as can be, none empty."""
    count = min(parts, len(indices))
    edges = [len(indices) * part // count for part in range(count + 1)]
    return [indices[start:end] for start, end in itertools.pairwise(edges)]
