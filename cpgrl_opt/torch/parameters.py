"""Which tensors move: those of a module or of the groups of an optimiser that are not frozen."""

from collections.abc import Collection, Iterable, Iterator
from typing import Any

import torch


def read_parameters(parameters: Any, dtypes: Collection[Any] = ()) -> list[Any]:
    """The parameters that are not frozen, in their order.

    Parameters
    ----------
    parameters : what optimisers of PyTorch take: tensors, named or not, or groups of them, dicts with "params".
    dtypes : those of which they may be; any real ones where there are none.

    Raises
    ------
    ValueError
        For what is no leaf, of another dtype, on another device, there twice, or none at all; for integers too, which
        would stay where they are and nobody would know.
    """
    given = [*_tensors_in(parameters)]
    found = [each for each in given if each.requires_grad]
    for k, each in enumerate(given):
        is_moving = each.requires_grad
        if is_moving and not each.is_leaf:
            raise ValueError(f"parameters should be leaf tensors; found that number {k} is computed from others")
        if not each.is_floating_point():
            wanted = "real" if each.is_complex() else "floating-point numbers, of which a gradient can be had"
            raise ValueError(f"parameters should be {wanted}; found that number {k} is of {each.dtype}")
        if is_moving and dtypes and each.dtype not in dtypes:
            names = ", ".join(map(str, dtypes))
            raise ValueError(f"parameters should be of {names}; found that number {k} is of {each.dtype}")
        if is_moving and each.device != found[0].device:
            raise ValueError(f"parameters should be on one device; found {found[0].device} and {each.device}")
    if not found:
        raise ValueError("parameters should have one that requires a gradient; found none")
    if len({*map(id, found)}) < len(found):
        raise ValueError("parameters should be there once each; found one twice")
    return found


def _tensors_in(parameters: Any) -> Iterator[Any]:
    if isinstance(parameters, torch.Tensor):
        parameters = [parameters]
    if isinstance(parameters, dict) or not isinstance(parameters, Iterable):
        raise ValueError(f"parameters should be tensors, or groups of them as optimisers take; found {parameters!r}")
    for each in parameters:
        if isinstance(each, dict) and "params" in each:
            yield from _tensors_in(each["params"])
        elif isinstance(each, tuple) and len(each) == 2 and isinstance(each[0], str):  # of named_parameters()
            yield from _tensors_in(each[1])
        elif isinstance(each, torch.Tensor):
            yield each
        else:
            raise ValueError(f"parameters should be tensors, or groups with 'params'; found {each!r}")
