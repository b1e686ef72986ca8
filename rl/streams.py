"""Random streams: run i of seed s draws the same numbers whatever else runs beside it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .policies.interface import require_count


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


def run_indices(runs: int | Sequence[int]) -> tuple[int, ...]:
    """0 … runs − 1, or the indices themselves; ValueError unless there is at least one, each ≥ 0."""
    if isinstance(runs, (int, np.integer)):
        require_count("runs", int(runs))
        return tuple(range(runs))
    indices = tuple(int(run) for run in runs)
    if not indices or min(indices) < 0:
        raise ValueError(f"runs should be a number ≥ 1 or indices ≥ 0; found {runs!r}")
    return indices
