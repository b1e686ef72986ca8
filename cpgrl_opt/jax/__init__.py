"""Constrained updates inside JAX: pytrees, under `jit`, `vmap`, `scan` and `grad`. Needs the extra `jax`.

    gradient, info = constrained_direction(values, gradients, thresholds, step)     # in the place of the loss's
    optimizer = constrain(optax.adam(1e-3), step, thresholds)                       # projects what it proposes

Channel 0 is a loss, which is minimised, and constraints are costs, which should stay below their thresholds, unless
kind="reward" says otherwise: the signs of those who write such loops. Everywhere else in this package they are turned.

_direction    `constrained_direction`; _trees: gradients as they come → leaves
_optimizer    `constrain`; _metric: what optimisers divide by
_info         what happened, `StepInfo`
_derivative   the answer with its derivative; _settings: what is asked of a step
_certified    the answer on the device: status and residuals; _projection, _pivoting, _rows: what it stands on
_host         the answer by the step itself, called back
"""

from ._direction import constrained_direction as constrained_direction
from ._info import StepInfo as StepInfo
from ._optimizer import ConstrainState as ConstrainState
from ._optimizer import constrain as constrain

__all__ = ["ConstrainState", "StepInfo", "constrain", "constrained_direction"]
