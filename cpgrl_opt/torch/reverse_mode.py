"""Reverse mode: gradients of losses, and a ValueError that names the loss whose graph cannot be differentiated."""

from collections.abc import Iterable
from typing import Any, NoReturn

import torch

from .ranks import differentiate_by_hooks, is_sharded

# What autograd says of graphs that cannot be differentiated, and what to ask for instead.
_FREED = "second time"
_BROKEN_GRAPHS = {
    _FREED: "have a graph that is still there (see retain_graph)",
    "donated buffers": "have a graph that is still there (see donated_buffer of compiled code)",
    "modified by an inplace operation": "have a graph whose tensors, parameters too, nobody has written to since",
}


def differentiate_one(name: str, tensor: Any, seed: float, parameters: list[Any], retain_graph: bool) -> list[Any]:
    """seed ∇tensor; ValueError for a graph that cannot be differentiated, and for sparse gradients."""
    start = torch.full_like(tensor, abs(seed))
    try:
        if is_sharded(parameters):
            row = differentiate_by_hooks(tensor, parameters, start, retain_graph)
        else:
            row = [*torch.autograd.grad(tensor, parameters, start, retain_graph=retain_graph, allow_unused=True)]
    except RuntimeError as error:
        _raise_for_graph(name, error)
    require_dense(name, row)
    return row if seed > 0.0 else _negate(row)


def _negate(row: Iterable[Any]) -> list[Any]:
    """Not in place: autograd's gradients may be views, of one number too."""
    return [None if part is None else -part for part in row]


def _raise_for_graph(name: str, error: RuntimeError) -> NoReturn:
    """ValueError where it is about a graph, else what was raised."""
    for sign, wanted in _BROKEN_GRAPHS.items():
        if sign in str(error):
            raise ValueError(f"{name} should {wanted}; found: {error}") from error
    raise error


def differentiate_all(
    names: list[str], tensors: list[Any], seeds: list[float], parameters: list[Any], retain_graph: bool
) -> list[list[Any]]:
    """All in one reverse pass, by `vmap`: the rows are views of stacked gradients."""
    outputs = torch.stack([tensor.reshape(()) for tensor in tensors])
    weights = torch.tensor(seeds, dtype=outputs.dtype, device=outputs.device)
    settings = {"retain_graph": retain_graph, "allow_unused": True, "is_grads_batched": True}
    try:
        parts = [*torch.autograd.grad(outputs, parameters, torch.diag(weights.abs()), **settings)]
    except RuntimeError as error:
        for name, tensor in zip(names, tensors, strict=True):  # which of them is it?
            try:
                differentiate_one(name, tensor, 1.0, parameters, retain_graph=True)
            except ValueError as found:
                if _FREED not in str(found):  # which the pass that failed may have done to all
                    raise
        _raise_for_graph("objective and constraints", error)
    for k, part in enumerate(parts):  # each goes as its successor is made
        if part is not None:
            parts[k] = part * weights.sign().to(part.dtype).reshape(-1, *[1] * (part.ndim - 1))
    return [[None if part is None else part[i] for part in parts] for i in range(len(tensors))]


def require_dense(name: str, row: Iterable[Any]) -> None:
    """ValueError that names what has a sparse gradient."""
    for k, part in enumerate(row):
        if part is not None and part.layout is not torch.strided:
            raise ValueError(
                f"{name} should have dense gradients; found {part.layout} in that of parameter number {k}, of shape "
                f"{tuple(part.shape)}: make the embedding with sparse=False"
            )
