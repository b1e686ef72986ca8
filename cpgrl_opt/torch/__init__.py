"""Constrained updates in a training loop of PyTorch, with thresholds and a certificate. Needs the extra `torch`.

    info = constrained_backward(loss, [cost_1, cost_2], thresholds=[0.1, 0.35], parameters=net.parameters(), step=step)

Objectives are losses, which are minimised, and constraints are costs, which should stay below their thresholds, unless
kind="reward" says otherwise: the signs of those who write such loops. Everywhere else in this package they are turned.

backward                `constrained_backward`, in the place of loss.backward()
constrained_optimizer   any optimiser's step, projected in its own metric; proposal, proposal_metric: these
channels                objective and constraints → gradients; parameters: which of them move
batch                   B problems of one shape on a device
derivative              a direction as a function that autograd differentiates
ranks                   data-parallel training, and sharded parameters
recomputed              gradients that are taken anew, a part at a time
step_info               what happened, by the names of the constraints
reverse_mode            gradients by autograd, and what is said of a graph that has none
loss_scale              mixed precision; tracing: what torch.compile does not look into
"""

from .backward import constrained_backward as constrained_backward
from .batch import solve_batch as solve_batch
from .constrained_optimizer import ConstrainedOptimizer as ConstrainedOptimizer
from .derivative import DifferentiableDirection as DifferentiableDirection
from .derivative import solve_direction as solve_direction
from .ranks import average_over_ranks as average_over_ranks
from .step_info import StepInfo as StepInfo

__all__ = [
    "ConstrainedOptimizer", "DifferentiableDirection", "StepInfo", "average_over_ranks", "constrained_backward",
    "solve_batch", "solve_direction",
]  # fmt: skip
