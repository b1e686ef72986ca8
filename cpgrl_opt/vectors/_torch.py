"""PyTorch's tensors: how NumPy sees those on the CPU, and sums over those of any device, in float64 and in blocks.

Called only with tensors of the caller's, who has imported torch: to import this does not.
"""

import sys
from collections.abc import Iterator
from operator import attrgetter
from typing import Any

import numpy as np

from ..compensated import Pair, product_error, split, two_sum

# Numbers of each vector at a time, and in pairs, where each product of two vectors has its sums: six vectors take
# 12 MB, and 19 MB of sums.
_BLOCK, _LANES = 1 << 18, 1 << 15
_MOST_SUMS = 1 << 22
_NAMES = {"torch.float64": np.float64, "torch.float32": np.float32, "torch.bfloat16": np.uint16}
NUMPYS = {name: np.dtype(dtype) for name, dtype in _NAMES.items()}  # what we read, of bfloat16 the bits


def is_tensor(value: Any) -> bool:
    """Whether it is a tensor: whoever has one has imported torch."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, torch.Tensor)


def is_apart(value: Any) -> bool:
    """Whether it is a tensor that NumPy cannot see, since it lies on another device."""
    return is_tensor(value) and not value.is_cpu


def detach(tensor: Any) -> Any:
    """The tensor without graph or sign bit; ValueError for what is sparse or has no float64 beside it."""
    if tensor.layout is not _torch().strided or (not tensor.is_cpu and tensor.device.type in ("meta", "mps")):
        raise ValueError(
            f"tensors should be dense and on a device that has float64; found {tensor.layout} on {tensor.device}"
        )
    addresses([tensor])
    tensor = tensor.detach() if tensor.requires_grad else tensor
    return tensor.resolve_neg() if tensor.is_neg() else tensor  # of a conjugate's imaginary part NumPy sees nothing


def is_float(tensor: Any) -> bool:
    """Of a dtype that we read."""
    return str(tensor.dtype) in NUMPYS


def as_array(tensor: Any) -> np.ndarray:
    """What NumPy sees of a tensor on the CPU, without a copy; of bfloat16 its bits."""
    torch, tensor = _torch(), detach(tensor)
    array: np.ndarray = (tensor.view(torch.uint16) if tensor.dtype == torch.bfloat16 else tensor).numpy()
    return array


def are_side_by_side(tensors: list[Any]) -> bool:
    """Whether they are tensors on the CPU of which NumPy would see all numbers side by side."""
    torch = _torch()
    Tensor = torch.Tensor
    return (
        {*map(type, tensors)} <= {Tensor, torch.nn.Parameter}  # others may be wrapped around what lies elsewhere
        and all(map(attrgetter("is_cpu"), tensors))
        and all(map(Tensor.is_contiguous, tensors))
        and not any(map(Tensor.is_neg, tensors))
        and is_float(tensors[0])
    )


def addresses(tensors: list[Any]) -> list[int]:
    """Where they begin; ValueError for what is traced and has no numbers."""
    try:
        return [*map(_torch().Tensor.data_ptr, tensors)]
    except RuntimeError as error:
        raise ValueError(f"tensors should have numbers, outside of torch.func; found none: {error}") from error


def as_tensor(part: Any, like: Any) -> Any:
    """The other way, in the shape of `like`, and on its device; a tensor is there already."""
    torch = _torch()
    if not isinstance(part, np.ndarray):
        return part.reshape(like.shape)
    part = part if part.flags.writeable else part.copy()  # of what is read-only it would warn
    tensor = torch.from_numpy(part if like.ndim == 1 else part.reshape(like.shape))  # by NumPy, which takes no time
    tensor = tensor.view(torch.bfloat16) if part.dtype.kind == "u" else tensor
    return tensor if like.is_cpu else tensor.to(like.device)


def rounded(part: np.ndarray, like: Any) -> Any:
    """Of the dtype of `like` too."""
    return _torch().from_numpy(np.require(part, requirements="W")).to(like)


def add_inner(K: Any, g: Any, J: Any) -> Any:
    """K + V Vᵀ on the device of V = [g; J]; K = 0 to begin with."""
    for block, _ in _blocks(g, J, _BLOCK):
        K = K + block @ block.T
    return K


def add_inner_in_pairs(K: Pair, g: Any, J: Any) -> Pair:
    """The same to 106 bits, lane by lane, as the sums of the compiled passes."""
    torch, count = _torch(), 1 + len(J)
    lanes = max(8, min(_LANES, _MOST_SUMS // count**2))
    total, rest = torch.zeros((2, count, count, lanes), dtype=torch.float64, device=g.device)
    for block, _ in _blocks(g, J, lanes):
        halves, width = split(block), block.shape[1]
        for i in range(count):  # a row of K at a time, so that what this takes beside is an m-th of the sums
            x, y = (block[i], halves[0][i], halves[1][i]), (block[: i + 1], *(half[: i + 1] for half in halves))
            product = x[0] * y[0]
            error = product_error(product, x[1], x[2], y[1], y[2])
            total[i, : i + 1, :width], lost = two_sum(total[i, : i + 1, :width], product)
            rest[i, : i + 1, :width] += error + lost
    while total.shape[-1] > 1:
        half = (total.shape[-1] + 1) // 2
        left, right = (torch.zeros_like(total[..., :half]) for _ in range(2))
        right[..., : total.shape[-1] - half] = total[..., half:]
        left[..., : total.shape[-1] - half] = rest[..., half:]
        total, lost = two_sum(total[..., :half], right)
        rest = rest[..., :half] + left + lost
    lower = (np.tril(part[..., 0].cpu().numpy()) for part in (total, rest))
    return K.plus(Pair(*(part + np.tril(part, -1).T for part in lower)))


def combine(weights: Pair, forces: np.ndarray, g: Any, J: Any) -> tuple[Any, Any]:
    """d = Vᵀw of g's dtype, in pairs where w.lo has any ≠ 0, and what it adds to the sums, d being unrounded."""
    torch = _torch()
    d, sums, in_pairs = torch.empty_like(g), 0.0, weights.lo.any()
    w, f = (torch.from_numpy(each.copy()).to(g.device) for each in (weights.hi, forces))
    for block, part in _blocks(g, J, _BLOCK):
        whole = _combine_in_pairs(weights, block) if in_pairs else w @ block
        d[part] = whole
        sums = sums + _measure(whole, f, block)
    return d, sums


def measure(d: Any, forces: np.ndarray, g: Any, J: Any) -> Any:
    """What a given d adds to the sums."""
    sums, f = 0.0, _torch().from_numpy(forces.copy()).to(g.device)
    for block, part in _blocks(g, J, _BLOCK):
        sums = sums + _measure(d[part].to(block), f, block)
    return sums


def _combine_in_pairs(weights: Pair, block: Any) -> Any:
    total = rest = _torch().zeros_like(block[0])
    for row, weight, more in zip(block, weights.hi.tolist(), weights.lo.tolist(), strict=True):
        product = weight * row
        error = product_error(product, *split(row), *split(weight))
        total, lost = two_sum(total, product)
        rest = rest + ((error + more * row) + lost)
    return total + rest


def _measure(d: Any, forces: Any, block: Any) -> Any:
    """[r·r, J d …, d·d]."""
    rest = d - forces @ block
    return _torch().cat([(rest @ rest)[None], block[1:] @ d, (d @ d)[None]])


def _blocks(g: Any, J: Any, width: int) -> Iterator[tuple[Any, slice]]:
    """Some numbers of g and of each row at a time, in float64; at least one block."""
    torch = _torch()
    for start in range(0, max(len(g), 1), width):
        part = slice(start, start + width)
        yield torch.stack([row[part].to(torch.float64) for row in (g, *J)]), part


def gather_by_torch(numbers: np.ndarray, group: Any = None) -> list[np.ndarray]:
    """What all processes of a group of torch.distributed hand over, in the order of their ranks."""
    torch = sys.modules.get("torch")
    if torch is None or not torch.distributed.is_available() or not torch.distributed.is_initialized():
        raise ValueError("torch.distributed should be initialised, or `gather` be given; found neither")
    device = "cuda" if torch.distributed.get_backend(group) == "nccl" else "cpu"
    mine = torch.from_numpy(numbers).to(device)
    parts = [torch.empty_like(mine) for _ in range(torch.distributed.get_world_size(group))]
    torch.distributed.all_gather(parts, mine, group=group)
    return [part.cpu().numpy() for part in parts]


def _torch() -> Any:
    return sys.modules["torch"]
