"""What an optimiser proposes, in the coordinates where its metric is the identity.

    Δ̃ = √H Δ,   J̃ = J/√H:   ‖Δ̃‖² = ‖Δ‖²_H,   J̃ Δ̃ = J Δ

Small parameters of a group lie side by side in one flat tensor, a piece: of a hundred tensors PyTorch's calls would
take longer than their numbers. The gradients of one piece after the other are scaled and let go, so that beside them
there are the parameters as they were, 1/√H, Δ̃ and its projection, and never a second matrix of m × n numbers.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import torch

from .ranks import local

# Numbers from which on a piece takes no further parameter. With 1e4 a call takes as long as the numbers do; pieces of
# 1e6 would be copied where a parameter alone is read where it lies.
_FULL = 1 << 16


@dataclass(frozen=True, eq=False)
class Piece:
    """Parameters of one group of an optimiser and of one dtype, and what they were before its step, flat."""

    group: Any
    parameters: list[Any]
    before: Any

    def change(self) -> Any:
        """Since then, a tensor of its own."""
        return flatten(self.parameters) - self.before

    def take(self, row: dict[int, Any]) -> Any:
        """Out of a row of gradients by the ids of parameters, not to be written to; None where it has nothing here."""
        parts = [row.pop(id(each), None) for each in self.parameters]
        if all(part is None for part in parts):
            return None
        pairs = zip(parts, self.parameters, strict=True)
        return flatten([torch.zeros_like(local(each)) if part is None else part for part, each in pairs])

    def put(self, numbers: Any) -> None:
        """Into the parameters, rounded to their dtype."""
        here = [local(each) for each in self.parameters]
        parts = numbers.split([each.numel() for each in here])
        for each, part in zip(here, parts, strict=True):
            each.copy_(part.view(each.shape))


def take_pieces(groups: Iterable[Any]) -> list[Piece]:
    """Of all parameters that are not frozen, as they are now, in the order of the groups."""
    found: list[tuple[Any, list[Any]]] = []
    for group in groups:
        count = _FULL
        for each in group["params"]:
            if not each.requires_grad:
                continue
            if count >= _FULL or each.dtype != found[-1][1][0].dtype:
                found.append((group, []))
                count = 0
            found[-1][1].append(each)
            count += each.numel()
    return [Piece(group, parameters, flatten(parameters, copy=True)) for group, parameters in found]


@dataclass(frozen=True, eq=False)
class Proposal:
    """Pieces that the optimiser's rates let move, and 1/√H of each, a number or flat."""

    pieces: list[Piece]
    scales: list[Any]

    def whiten(self, rows: list[dict[int, Any]]) -> list[list[Any]]:
        """[Δ̃, *J̃], a flat tensor a piece; rows: by the ids of parameters, 0 where they have none. They are emptied."""
        whitened: list[list[Any]] = [[] for _ in range(1 + len(rows))]
        for piece, scale in zip(self.pieces, self.scales, strict=True):
            proposed, zero = piece.change().div_(scale), None
            whitened[0].append(proposed)
            for row, to in zip(rows, whitened[1:], strict=True):
                part = piece.take(row)
                if part is None:  # one zero for all rows
                    zero = torch.zeros_like(proposed) if zero is None else zero
                to.append(zero if part is None else part * scale)
        return whitened

    def replace(self, change: list[Any]) -> None:
        """Moves the parameters by the change, Δ̃′, instead, which is overwritten."""
        for piece, scale, part in zip(self.pieces, self.scales, change, strict=True):
            if isinstance(scale, torch.Tensor):
                piece.put(torch.addcmul(piece.before, part, scale, out=part))
            else:
                piece.put(torch.add(piece.before, part, alpha=scale, out=part))


def flatten(tensors: list[Any], *, copy: bool = False) -> Any:
    """Side by side, of float32 at least, without a graph; one alone is a view, unless a copy is asked for.

    Of shards what this rank has.
    """
    flat = [local(each.detach()).reshape(-1) for each in tensors]
    joined = torch.cat(flat) if copy or len(flat) > 1 else flat[0]
    return joined.float() if joined.dtype.itemsize < torch.float32.itemsize else joined
