"""Vectors of every kind for the tests: numbers, an object of the caller's, and threads that stand for processes."""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from cpgrl_opt.compensated import Pair
from cpgrl_opt.vectors import ArrayVectors


def draw(seed: int, n: int = 40, m: int = 3) -> np.ndarray:
    """[g; J] of numbers that bfloat16 holds: rows apart, opposing, dependent, or g in the span of −J."""
    V = np.random.default_rng(seed).integers(-9, 10, (1 + m, n)) / 8.0
    if seed % 4 == 1:
        V[2] = -V[1]
    if seed % 4 == 2:
        V[3] = 2.0 * V[2]
    if seed % 4 == 3:
        V[0] = -(V[1:].T @ [1.0, 0.0, 2.0])
    return V


class Kept:
    """Vectors in memory, in an object; `n` is told."""

    def __init__(self, V: np.ndarray) -> None:
        self.V, self.n, self.vectors = V, V.shape[1], ArrayVectors(V[0], V[1:])

    def gramian(self) -> np.ndarray:
        return self.vectors.find_gramian()

    def lincomb(self, weights: np.ndarray) -> Any:
        return weights @ self.V

    def extended(self, *vectors: Any) -> "Kept":
        return type(self)(np.vstack([self.V, *vectors]))


class InPairs(Kept):
    """One that offers pairs too."""

    def gramian_in_pairs(self) -> Pair:
        return self.vectors.gramian_in_pairs()

    def lincomb_in_pairs(self, hi: np.ndarray, lo: np.ndarray) -> Any:
        return self.vectors.form(Pair(hi, lo), hi)[0]


class Ranks:
    """Threads that stand for processes; what they send is counted."""

    def __init__(self, count: int) -> None:
        self.count, self.sent, self.slots = count, [list[int]() for _ in range(count)], [np.empty(0)] * count
        self.meeting = threading.Barrier(count, timeout=20.0)  # s; a rank that waits longer would wait for ever

    def run(self, work: Callable[[int, Any], Any]) -> list[Any]:
        """work(rank, gather) on each rank: what it returns or raises."""
        found: list[Any] = [None] * self.count

        def try_work(rank: int) -> None:
            try:
                found[rank] = work(rank, lambda numbers: self.gather(rank, numbers))
            except Exception as error:
                found[rank] = error

        threads = [threading.Thread(target=try_work, args=(rank,)) for rank in range(self.count)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return found

    def gather(self, rank: int, numbers: np.ndarray) -> list[np.ndarray]:
        self.slots[rank] = numbers.copy()
        self.sent[rank].append(numbers.nbytes)
        self.meeting.wait()
        gathered = list(self.slots)
        self.meeting.wait()
        return gathered
