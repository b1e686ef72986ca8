"""Gradients that are never all there: of some parameters at a time, taken anew whenever they are asked for.

    K = Σ V_c V_cᵀ,   d_c = V_cᵀw        c: chunks of the parameters

With 1 + m chunks they take the memory of one gradient, at 2 (1 + m) reverse passes a chunk, each of which ends at the
chunk's parameters. Losses that are functions are called as often, and should return the same each time.
"""

from collections.abc import Callable, Iterator
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np

from ..compensated import Pair
from ..vectors import Vectors
from ..vectors._kinds import kind_of

Differentiate = Callable[[list[Any]], list[list[Any]]]


class RecomputedVectors(Vectors):
    """differentiate: parameters → the gradients of all channels with respect to them, the objective's first."""

    def __init__(self, differentiate: Differentiate, chunks: list[list[Any]], count: int) -> None:
        self._differentiate, self._chunks, self._count = differentiate, chunks, count

    @property
    def gradient(self) -> Any:
        """It is they."""
        return self

    @cached_property
    def shape(self) -> tuple[int, int]:
        """(m, n)."""
        return self._count - 1, sum(each.numel() for chunk in self._chunks for each in chunk)

    def are_finite(self) -> bool:
        """Seen in K."""
        return bool(np.isfinite(self.gramian().trace()))

    def is_zero(self, index: int) -> bool:
        """In all chunks."""
        return all(part.is_zero(index) for part in self._parts())

    def find_gramian(self) -> Any:
        """One pass."""
        return sum(part.gramian() for part in self._parts())

    def gramian_in_pairs(self) -> Pair:
        """One pass."""
        K = Pair(*np.zeros((2, self._count, self._count)))
        for part in self._parts():
            K = K.plus(part.gramian_in_pairs())
        return K

    def form(self, weights: Pair, forces: Any) -> tuple[Any, Any]:
        """One pass; d in the order of the chunks' parameters."""
        d, total = [], np.zeros(1 + self._count)
        for part in self._parts():
            own, sums = part.form(weights, forces)
            d += own
            total += sums
        return d, total

    def measure(self, direction: Any, forces: Any) -> Any:
        """One pass."""
        ends = [0, *accumulate(map(len, self._chunks))]
        parts = zip(self._parts(), ends, ends[1:], strict=False)
        return sum(part.measure(direction[start:end], forces) for part, start, end in parts)

    def _parts(self) -> Iterator[Vectors]:
        for chunk in self._chunks:
            gradient, *rows = self._differentiate(chunk)
            vectors = kind_of(gradient, rows)
            assert vectors is not None  # tensors are a kind
            del gradient, rows
            yield vectors


def split(parameters: list[Any], count: int) -> list[list[Any]]:
    """At most so many chunks of about the same size, in order; a parameter is not split."""
    total, chunks, filled = sum(each.numel() for each in parameters), [list[Any]()], 0
    for each in parameters:
        if chunks[-1] and filled >= len(chunks) * total / count:
            chunks.append([])
        chunks[-1].append(each)
        filled += each.numel()
    return chunks
