"""Mixed precision: a `torch.amp.GradScaler` scales losses, so that gradients of float16 do not underflow."""

from typing import Any

import numpy as np
import torch

from ..direction import Status
from .channels import Channels, are_finite
from .step_info import StepInfo


def scale_of(scaler: Any) -> float:
    """By which it scales; 1 where there is none, or it is switched off."""
    if scaler is None or not scaler.is_enabled():
        return 1.0
    scaler.scale(torch.zeros((), device=getattr(scaler, "_device", "cpu")))  # without which it would not know its scale
    return float(scaler.get_scale())


def unscale(rows: list[list[Any]], scale: float) -> None:
    """In place of each gradient, one after the other, itself over the scale."""
    if scale == 1.0:
        return
    for row in rows:
        for k, part in enumerate(row):
            row[k] = part / scale


def overflows(rows: list[list[Any]], scaler: Any) -> bool:
    """Whether a gradient is not finite where the scaler waits for that: it then lowers its scale."""
    is_on = scaler is not None and scaler.is_enabled()
    return is_on and not all(map(are_finite, rows))


def skip(parameters: list[Any], channels: Channels, values: np.ndarray) -> StepInfo:
    """NaN in `.grad`, at which scaler.step skips the optimiser's."""
    for each in parameters:
        each.grad = torch.full_like(each, float("nan"))
    slack = values[1:] - channels.slack_thresholds()
    none = np.zeros(len(slack), np.bool_)
    return StepInfo.of(channels.names, np.nan * slack, none, slack, slack, status=Status.NUMERICAL_ERROR)
