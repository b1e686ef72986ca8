"""Contenders timed in turns, so that what slows the machine for a while slows them all."""

import time
from collections.abc import Callable, Mapping
from typing import Any


def time_in_turns(
    works: Mapping[str, Callable[[], Any]], repetitions: int
) -> tuple[dict[str, list[float]], dict[str, Any]]:
    """CPU seconds of every repetition, and what each work returned last."""
    seconds: dict[str, list[float]] = {name: [] for name in works}
    results = {}
    for _ in range(repetitions):
        for name, work in works.items():
            begun = time.process_time()
            results[name] = work()
            seconds[name].append(time.process_time() - begun)
    return seconds, results
