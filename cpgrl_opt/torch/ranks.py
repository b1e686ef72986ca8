"""Training on several ranks: gradients averaged where each has a share of the data, and shards of parameters.

    data parallel        g = mean g_p,   J = mean J_p,   values = mean values_p            p: ranks, each with all of θ
    shards (DTensors)    the same means, of which each rank has its part; K = Σ K_p, as in `vectors.Sharded`

Shards are those of `torch.distributed.fsdp.fully_shard`. Their gradients exist in `.grad` alone, after the hooks of a
whole `backward`: so they are taken there, and what `.grad` was before is put back.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch

from ..vectors import gather_by_torch

Average = Callable[[list[Any]], list[Any]]


def average_over_ranks(tensors: list[Any], group: Any = None) -> list[Any]:
    """Each tensor's mean over the ranks of a group of torch.distributed, by default all; the same bits on all of them.

    Tensors of one dtype travel side by side. For another group: `partial(average_over_ranks, group=group)`.
    """
    distributed = torch.distributed
    if not distributed.is_available() or not distributed.is_initialized():
        raise ValueError("torch.distributed should be initialised, or `average` be given; found neither")
    found: dict[int, Any] = {}
    for dtype in dict.fromkeys(each.dtype for each in tensors):  # in one order on all ranks, as a set has not
        places = [k for k, each in enumerate(tensors) if each.dtype == dtype]
        flat = torch.cat([tensors[k].detach().reshape(-1) for k in places])
        distributed.all_reduce(flat, group=group)
        flat /= distributed.get_world_size(group)
        parts = flat.split([tensors[k].numel() for k in places])
        found.update({k: part.view(tensors[k].shape) for k, part in zip(places, parts, strict=True)})
    return [found[k] for k in range(len(tensors))]


def share(
    found: tuple[np.ndarray, list[list[Any]], list[Any]], parameters: list[Any], average: Any, gather: Any
) -> tuple[np.ndarray, list[list[Any]], list[Any]]:
    """What `Channels.differentiate` found on this rank, as all ranks together have it.

    average: of data-parallel training, or None; the means of shards are taken by FSDP, and here those of the values.
    """
    values, rows, reached = found
    if average is None:
        return (np.mean(gather(values), axis=0), rows, reached) if is_sharded(parameters) else found
    here = {*map(id, reached)}
    numbers = [*values.tolist(), *(float(id(each) in here) for each in parameters)]
    means = average([torch.tensor(numbers, dtype=torch.float64, device=parameters[0].device)])[0].cpu().numpy()
    reached_anywhere = [each for each, part in zip(parameters, means[len(values) :], strict=True) if part > 0.0]
    for i, row in enumerate(rows):
        known = dict(zip(map(id, reached), row, strict=True))
        rows[i] = average(
            [known[id(each)] if id(each) in here else torch.zeros_like(each) for each in reached_anywhere]
        )
    return means[: len(values)], rows, reached_anywhere


def read_gather(parameters: list[Any], average: Any, gather: Any, **others: Any) -> Any:
    """The caller's, or that of the mesh of shards; ValueError for what does not go together."""
    if average is not None and not callable(average):
        raise ValueError(f"average should be a function of a list of tensors, or None; found {average!r}")
    if average is not None and gather is not None:
        raise ValueError("average should be None with gather: a rank has all parameters, or a part; found both")
    if not is_sharded(parameters):
        return gather
    for name, each in {"average": average, "gather": gather, **others}.items():
        if each is not None and each is not False:
            raise ValueError(f"{name} should be left out where parameters are sharded; found {each!r}")
    return partial(gather_by_torch, group=parameters[0].device_mesh.get_group())


def is_sharded(parameters: list[Any]) -> bool:
    """Whether they are DTensors; ValueError for what is not all of one mesh of one dimension."""
    meshes = [getattr(each, "device_mesh", None) for each in parameters]
    if meshes[0] is None and all(each is None for each in meshes):
        return False
    for each in meshes:
        if each is None or each != meshes[0] or each.ndim != 1:
            raise ValueError(f"parameters should all be sharded over one mesh of one dimension; found {meshes}")
    if not all(each.placements[0].is_shard() for each in parameters):
        raise ValueError(f"parameters should be sharded; found {parameters[0].placements}")
    return True


def local(tensor: Any) -> Any:
    """Of a DTensor the part of this rank, as a view; any other tensor itself."""
    return tensor.to_local() if hasattr(tensor, "to_local") else tensor


def differentiate_by_hooks(tensor: Any, parameters: list[Any], start: Any, retain_graph: bool) -> list[Any]:
    """Parts of this rank of the gradients, through `.grad`; None where there is none."""
    kept = [each.grad for each in parameters]
    try:
        for each in parameters:
            each.grad = None
        tensor.backward(start, retain_graph=retain_graph)
        return [None if each.grad is None else local(each.grad).detach() for each in parameters]
    finally:
        for each, grad in zip(parameters, kept, strict=True):
            each.grad = grad


def as_gradient(part: Any, parameter: Any) -> Any:
    """A part of this rank in the form of the parameter."""
    if not hasattr(parameter, "to_local"):
        return part
    from torch.distributed.tensor import DTensor

    form = {"shape": parameter.shape, "stride": parameter.stride()}
    return DTensor.from_local(part, parameter.device_mesh, parameter.placements, **form)
