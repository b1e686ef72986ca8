"""Contenders timed in turns, so that what slows the machine for a while slows them all."""

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np


def time_in_turns(
    works: Mapping[str, Callable[[], Any]], repetitions: int, calls: int = 1
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """CPU seconds of a call, by repetition, and what each work returned last; a first turn, to compile, is free."""
    seconds: dict[str, list[float]] = {name: [] for name in works}
    results: dict[str, Any] = {}
    for _ in range(1 + repetitions):
        for name, work in works.items():
            results[name] = None  # two directions at once are no part of the work
            begun = time.process_time()
            for _ in range(calls):
                results[name] = work()
            seconds[name].append((time.process_time() - begun) / calls)
    return {name: np.array(times[1:]) for name, times in seconds.items()}, results
