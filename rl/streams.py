"""Random streams: run i of seed s draws the same numbers whatever else runs beside it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from cpgrl_opt.validation import require_count

MOST_COUNTED = 2**63 - 1  # steps and episodes, which kernels count in 64 bits
MOST_RUNS = 1_000_000  # in lockstep; beyond, a slip of the keyboard would fill the memory


@dataclass(frozen=True, eq=False)
class RunStreams:
    """The streams of one run: one for its first θ, one for its episodes."""

    initial: np.random.SeedSequence
    episodes: np.random.SeedSequence


def run_streams(seed: int, run: int) -> RunStreams:
    """Streams (seed, run, 0) and (seed, run, 1): a function of seed and run alone."""
    require_count("seed", seed, 0)
    initial, episodes = np.random.SeedSequence(seed, spawn_key=(run,)).spawn(2)
    return RunStreams(initial, episodes)


def run_indices(runs: int | Sequence[int], name: str = "runs") -> tuple[int, ...]:
    """0 … runs − 1, or the indices themselves; ValueError unless there is at least one, each ≥ 0, none twice."""
    if isinstance(runs, (int, np.integer)):
        require_count(name, runs, most=MOST_RUNS)
        return tuple(range(runs))
    given: object = runs
    indices = tuple(given) if isinstance(given, Iterable) else ()
    whole = all(isinstance(run, (int, np.integer)) and not isinstance(run, bool) for run in indices)
    if not indices or not whole or min(indices) < 0:
        raise ValueError(f"{name} should be a number ≥ 1 or indices ≥ 0; found {runs!r}")
    if len(set(indices)) < len(indices):
        raise ValueError(f"{name} should be indices that differ, since the same index is the same run; found {runs!r}")
    return tuple(map(int, indices))
