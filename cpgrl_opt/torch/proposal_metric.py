"""The metric in which an optimiser's own step is the steepest: what it divides its gradient by, over its rate.

    Δ = −H⁻¹ĝ        SGD: H = 1/lr     Adam, AdamW, NAdam: (√v̂ + eps)/lr     RMSprop, Adagrad, Adamax: likewise

ĝ is the gradient as the optimiser sees it, with momentum and decay. Of what is not listed H = 1/lr.
"""

import math
from collections.abc import Callable
from typing import Any

import torch

from .proposal import Piece, flatten

# Least entry, in units of 1/lr: √v̂ + eps of a parameter whose gradient was 0 up to now, where eps = 0.
_LEAST = 1e-15

Metric = Callable[[Any], Any]  # H of one parameter, a number or a tensor of its shape


def scale_of(optimizer: Any, piece: Piece, metric: Metric | None) -> Any:
    """1/√H of a piece, after the optimiser's step: a number, or a flat tensor. metric: the caller's, if there is one.

    ValueError for a metric that is not positive, or of another shape.
    """
    H = metric_of(optimizer, piece.group, piece.parameters) if metric is None else _ask(metric, piece)
    if isinstance(H, torch.Tensor):
        return H.rsqrt_()
    return H**-0.5 if H > 0.0 else math.inf  # of an infinite rate, whose proposal is refused


def metric_of(optimizer: Any, group: Any, parameters: list[Any]) -> Any:
    """H of parameters of one group, after the optimiser's step: a number, or a flat tensor of its own.

    A parameter that the optimiser has not seen yet has 1/lr.
    """
    rate, states = float(group.get("lr", 1.0)), [optimizer.state.get(each) or {} for each in parameters]
    counts = [float(state.get("step", 0)) for state in states]
    if len({*counts}) > 1:  # one has been without a gradient
        each = [metric_of(optimizer, group, [parameter]) for parameter in parameters]
        return flatten(
            [H if torch.is_tensor(H) else torch.full_like(p, H) for H, p in zip(each, parameters, strict=True)]
        )
    for kind, denominator in _DENOMINATORS.items():
        if isinstance(optimizer, kind) and counts[0] > 0.0:  # Adagrad has a state from the start
            return denominator(group, states, counts[0]).clamp_(min=_LEAST).div_(rate)
    return 1.0 / rate


def _ask(metric: Metric, piece: Piece) -> Any:
    found = []
    for each in piece.parameters:
        H = metric(each)
        if not isinstance(H, torch.Tensor):
            H = torch.full_like(each, float(H), dtype=piece.before.dtype)
        if H.shape != each.shape:
            raise ValueError(f"metric should have shape {tuple(each.shape)}; found {tuple(H.shape)}")
        if not bool((H > 0.0).all()):
            raise ValueError(f"metric should be positive; found {H.min().item():g}")
        found.append(H)
    return flatten(found, copy=True)


def _adam(group: Any, states: list[Any], count: float) -> Any:
    v = _flat(states, "max_exp_avg_sq" if group.get("amsgrad") else "exp_avg_sq")
    correction = 1.0 - float(group["betas"][1]) ** count
    return v.sqrt().mul_(correction**-0.5).add_(group["eps"])


def _adamax(group: Any, states: list[Any], count: float) -> Any:
    return _flat(states, "exp_inf") * (1.0 - float(group["betas"][0]) ** count)


def _rmsprop(group: Any, states: list[Any], count: float) -> Any:  # noqa: ARG001
    v = _flat(states, "square_avg")
    if group["centered"]:
        v = v - _flat(states, "grad_avg").square()
    return v.clamp(min=0.0).sqrt_().add_(group["eps"])


def _adagrad(group: Any, states: list[Any], count: float) -> Any:
    decay = 1.0 + (count - 1.0) * float(group["lr_decay"])
    return _flat(states, "sum").sqrt().add_(group["eps"]).mul_(decay)


def _flat(states: list[Any], name: str) -> Any:
    return flatten([state[name] for state in states])


_DENOMINATORS: dict[Any, Callable[[Any, list[Any], float], Any]] = {
    torch.optim.Adam: _adam,
    torch.optim.AdamW: _adam,
    torch.optim.NAdam: _adam,
    torch.optim.Adamax: _adamax,
    torch.optim.RMSprop: _rmsprop,
    torch.optim.Adagrad: _adagrad,
}
