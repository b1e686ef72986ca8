"""What an optimiser proposes, in the coordinates where its metric is the identity.

    Δ̃ = √H Δ,   J̃ = J/√H:   ‖Δ̃‖² = ‖Δ‖²_H,   J̃ Δ̃ = J Δ

The gradients are divided one tensor at a time, so that beside them there are Δ, √H and the parameters as they were.
"""

from dataclasses import dataclass
from typing import Any

import torch


@dataclass(frozen=True, eq=False)
class Move:
    """A parameter, what it was before, and √H."""

    parameter: Any
    before: Any
    root: Any

    @classmethod
    def of(cls, parameter: Any, before: Any, metric: Any) -> "Move":
        """ValueError for a metric that is not positive, or of another shape."""
        is_number = not isinstance(metric, torch.Tensor)
        if not (metric > 0.0 if is_number else bool((metric > 0.0).all())):
            raise ValueError(f"metric should be positive; found {metric if is_number else metric.min().item()}")
        if not is_number and metric.shape != parameter.shape:
            raise ValueError(f"metric should have shape {tuple(parameter.shape)}; found {tuple(metric.shape)}")
        return cls(parameter, before, metric**0.5)


@dataclass(frozen=True, eq=False)
class Proposal:
    """Of the parameters that move, in the order of the optimiser's groups."""

    moves: list[Move]

    def whiten(self, rows: list[dict[int, Any]]) -> list[list[Any]]:
        """[Δ̃, *J̃]; rows: by the ids of parameters, 0 where they have none. They are emptied."""
        proposal = [(_wide(each.parameter) - each.before) * each.root for each in self.moves]
        zeros = [
            torch.zeros_like(part) if any(id(each.parameter) not in row for row in rows) else None
            for each, part in zip(self.moves, proposal, strict=True)
        ]  # one for all rows
        return [proposal, *([*map(_divide, self.moves, zeros, len(zeros) * [row])] for row in rows)]

    def replace(self, change: list[Any]) -> None:
        """Moves the parameters by the change, Δ̃′, instead."""
        for each, part in zip(self.moves, change, strict=True):
            each.parameter.copy_(each.before + part / each.root)


def _divide(move: Move, zero: Any, row: dict[int, Any]) -> Any:
    part = row.pop(id(move.parameter), None)
    return zero if part is None else _wide(part) / move.root


def _wide(tensor: Any) -> Any:
    """Of float32 at least, without a graph."""
    tensor = tensor.detach()
    return tensor.float() if tensor.dtype.itemsize < torch.float32.itemsize else tensor
