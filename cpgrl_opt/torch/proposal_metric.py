"""The metric in which an optimiser's own step is the steepest: what it divides its gradient by, over its rate.

    Δ = −H⁻¹ĝ        SGD: H = 1/lr     Adam, AdamW, NAdam: (√v̂ + eps)/lr     RMSprop, Adagrad, Adamax: likewise

ĝ is the gradient as the optimiser sees it, with momentum and decay. Of what is not listed H = 1/lr.
"""

from collections.abc import Callable
from typing import Any

import torch

# Least entry, in units of 1/lr: √v̂ + eps of a parameter whose gradient was 0 up to now, where eps = 0.
_LEAST = 1e-15


def metric_of(optimizer: Any, group: Any, parameter: Any) -> Any:
    """H of one parameter, after the optimiser's step: a number, or a tensor of its shape.

    A parameter that the optimiser has not seen yet has 1/lr.
    """
    rate, state = float(group.get("lr", 1.0)), optimizer.state.get(parameter) or {}
    for kind, denominator in _DENOMINATORS.items():
        if isinstance(optimizer, kind) and float(state.get("step", 0)) > 0.0:  # Adagrad has a state from the start
            found = denominator(group, state)
            return found.clamp_(min=_LEAST).div_(rate)
    return 1.0 / rate


def _adam(group: Any, state: Any) -> Any:
    v = state["max_exp_avg_sq"] if group.get("amsgrad") else state["exp_avg_sq"]
    correction = 1.0 - float(group["betas"][1]) ** float(state["step"])
    return _wide(v).div(correction).sqrt_().add_(group["eps"])


def _adamax(group: Any, state: Any) -> Any:
    return _wide(state["exp_inf"]) * (1.0 - float(group["betas"][0]) ** float(state["step"]))


def _rmsprop(group: Any, state: Any) -> Any:
    v = _wide(state["square_avg"])
    if group["centered"]:
        v = v - _wide(state["grad_avg"]).square()
    return v.clamp(min=0.0).sqrt_().add_(group["eps"])


def _adagrad(group: Any, state: Any) -> Any:
    decay = 1.0 + (float(state["step"]) - 1.0) * float(group["lr_decay"])
    return _wide(state["sum"]).sqrt().add_(group["eps"]).mul_(decay)


def _wide(tensor: Any) -> Any:
    """Of float32 at least."""
    return tensor.float() if tensor.dtype.itemsize < torch.float32.itemsize else tensor


_DENOMINATORS: dict[Any, Callable[[Any, Any], Any]] = {
    torch.optim.Adam: _adam,
    torch.optim.AdamW: _adam,
    torch.optim.NAdam: _adam,
    torch.optim.Adamax: _adamax,
    torch.optim.RMSprop: _rmsprop,
    torch.optim.Adagrad: _adagrad,
}
