"""In the place of loss.backward(): one gradient for the optimiser, that of a step under constraints.

    p.grad += −change/α₁                    SGD with lr = α₁ moves by the change of `ConstrainedStep`, α₁ its step_size

Where no constraint is active this is ∇loss.
"""

from typing import Any

import torch

from ..linearization import Linearization
from ..step import ConstrainedStep
from ..validation import require_count
from .channels import Channels, Gather, linearize, take_step
from .loss_scale import overflows, scale_of, skip, unscale
from .parameters import read_parameters
from .ranks import Average, as_gradient, local, read_gather, share
from .recomputed import RecomputedVectors, split
from .step_info import StepInfo, describe
from .tracing import run_uncompiled

_DTYPES = (torch.float64, torch.float32, torch.bfloat16)  # of which vectors are read


@run_uncompiled
def constrained_backward(
    objective: Any,
    constraints: Any,
    *,
    values: Any = None,
    thresholds: Any,
    parameters: Any,
    step: ConstrainedStep,
    kind: str = "cost",
    previous: StepInfo | None = None,
    retain_graph: bool = False,
    batched: bool = False,
    scaler: Any = None,
    gather: Gather | None = None,
    average: Average | None = None,
    chunks: int | None = None,
) -> StepInfo:
    """Adds to `.grad` of each parameter what descends the objective under the constraints.

    Parameters
    ----------
    objective : the loss, a tensor of one number that is minimised, or a function that makes it.
    constraints : tensors of one number, in a list or by name in a dict, or one tensor (m,). Functions in their place
        are called one after the other, each graph being freed before the next is made.
    values : (m,) or by name, where the tensors are surrogates that have the gradients and not the values, as those of
        policy gradients. By default the tensors' own.
    thresholds : (m,) or by name: upper limits of costs, lower limits of rewards.
    parameters : tensors or groups, as an optimiser takes them. Frozen ones, and those that nothing depends on, are
        left alone.
    step : how constraints are met; step.step_size is the rate at which its change is exact.
    kind : "cost", whose values should be ≤ thresholds, or "reward", ≥. The objective is a loss with either.
    previous : the last update's, for rules with memory.
    retain_graph : as of `backward`.
    batched : all gradients in one reverse pass (`vmap`), which takes the memory of all at once.
    scaler : a `torch.amp.GradScaler`, for losses as they are, unscaled; scaler.step and scaler.update follow as usual.
    gather : where each process has a part of the parameters, of one model, as in `vectors.Sharded`: for example
        `vectors.gather_by_torch`. Values are those of the whole model.
    average : where each process has all parameters and a share of the data, as in `DistributedDataParallel`: tensors of
        this process → their means over all, `average_over_ranks` or of the caller's. Gradients and values are averaged.
        Parameters sharded by `fully_shard` ask for neither.
    chunks : gradients of so many parts of the parameters, one part at a time, taken anew when they are asked for: with
        1 + m chunks in the memory of one gradient. Graphs stay; not with `batched`, `scaler`, `gather` or `average`.

    Raises
    ------
    ValueError
        For what does not fit, a graph that is gone, NaN; DirectionError if `step.on_failure` says so. Then nothing is
        written.
    """
    rate, scale = _require_rate(step), scale_of(scaler)
    channels = Channels.read(objective, constraints, values, thresholds, kind)
    moving = read_parameters(parameters, _DTYPES)
    gather = read_gather(moving, average, gather, batched=batched, scaler=scaler, chunks=chunks)
    if chunks is not None:
        _require_chunks(chunks, batched=batched, scaler=scaler, gather=gather, average=average)
        linearization, reached = _recompute(channels, moving, chunks), moving
    else:
        settings: dict[str, Any] = {"scale": scale, "retain_graph": retain_graph, "batched": batched}
        found, gradients, reached = share(channels.differentiate(moving, **settings), moving, average, gather)
        if overflows(gradients, scaler):
            return skip(moving, channels, found)
        unscale(gradients, scale)
        linearization = linearize(found, gradients, channels, gather)
    result = take_step(step, linearization, channels, None if previous is None else previous.previous)
    accumulate(reached, result.change, -scale / rate)
    return describe(result, linearization.slack(channels.slack_thresholds()), channels.names)


def accumulate(parameters: list[Any], changes: list[Any], factor: float) -> None:
    """factor × changes into `.grad`, as `backward` does; they are overwritten."""
    with torch.no_grad():
        for parameter, change in zip(parameters, changes, strict=True):
            if parameter.grad is not None:
                local(parameter.grad).add_(change, alpha=factor)
            else:
                # 0 + …, in one pass: a factor < 0 alone would make −0.0 of 0
                zero = torch.zeros((), dtype=change.dtype, device=change.device)
                parameter.grad = as_gradient(torch.add(zero, change, alpha=factor, out=change), parameter)


def _recompute(channels: Channels, parameters: list[Any], chunks: int) -> Linearization:
    """Of gradients that are taken anew."""
    parts = split(parameters, chunks)
    return Linearization(
        channels.evaluate(), RecomputedVectors(channels.differentiate_again, parts, 1 + len(channels.constraints))
    )


def _require_chunks(chunks: Any, **others: Any) -> None:
    require_count("chunks", chunks)
    if any(each is not None and each is not False for each in others.values()):
        raise ValueError(f"chunks should be None with {', '.join(others)}; found {chunks}")


def _require_rate(step: ConstrainedStep) -> float:
    if not isinstance(step, ConstrainedStep):
        raise ValueError(f"step should be a ConstrainedStep; found {step!r}")
    if step.step_size == 0:
        raise ValueError("step_size of step should be > 0, which .grad is in units of; found 0")
    return float(step.step_size)  # type: ignore[arg-type]
