"""Trees of PyTorch's tensors on any device: no vector leaves it, unless a problem is put together as arrays."""

from typing import Any

import numpy as np

from ..arrays import Float
from ..compensated import Pair
from . import _torch
from ._trees import TreeVectors
from .interface import Sums


class TensorVectors(TreeVectors):
    """Tensors where they lie; all sums are of float64, of blocks. On the CPU `TreeVectors` is faster."""

    def look_at(self, leaf: Any) -> Any:
        """The tensor without its graph; None for another dtype."""
        if not _torch.is_tensor(leaf):
            return super().look_at(leaf)
        tensor = _torch.detach(leaf)
        return tensor if _torch.is_float(tensor) else None

    def host(self, part: Any) -> np.ndarray:
        """A copy."""
        return np.asarray(part.double().cpu().numpy()) if _torch.is_tensor(part) else super().host(part)

    def rounded(self, part: np.ndarray, like: Any) -> Any:
        """On the device."""
        return _torch.rounded(part, like)

    def place(self, part: Any, like: Any) -> Any:
        """On the device."""
        return part if _torch.is_tensor(part) else _torch.as_tensor(np.asarray(self.host(part), np.float64), like)

    def find_gramian(self) -> Float[np.ndarray, "channels channels"]:
        """In one pass."""
        K: Any = 0.0
        for g, J in self.leaves:
            K = _torch.add_inner(K, g, J)
        return np.asarray(K.cpu().numpy())

    def gramian_in_pairs(self) -> Pair:
        """In one pass."""
        K = Pair(self._square(), self._square())
        for g, J in self.leaves:
            K = _torch.add_inner_in_pairs(K, g, J)
        return K

    def form(self, weights: Pair, forces: Float[np.ndarray, "channels"]) -> tuple[Any, Sums]:
        """In one pass."""
        parts, sums = zip(*(_torch.combine(weights, forces, g, J) for g, J in self.leaves), strict=True)
        return self.rebuild([*parts]), np.asarray(sum(sums).cpu().numpy())

    def measure(self, direction: Any, forces: Float[np.ndarray, "channels"]) -> Sums:
        """In one pass."""
        pairs = zip(self.take_apart(direction), self.leaves, strict=True)
        return np.asarray(sum(_torch.measure(d, forces, g, J) for d, (g, J) in pairs).cpu().numpy())
