"""Constrained updates inside JAX: pytrees, under `jit`, `vmap`, `scan` and `grad`. Needs the extra `jax`.

    found = constrained_direction(values, gradients, thresholds, step)      # found.gradient for the loss's own
    optimizer = constrain(optax.adam(1e-3), step)                           # projects what the optimiser proposes

Channel 0 is a loss, which is minimised, and constraints are costs, which should stay below their thresholds, unless
kind="reward" says otherwise: the signs of those who write such loops. Everywhere else in this package they are turned.

_direction    `constrained_direction`; _trees: gradients as they come → leaves
_optimizer    `constrain`, and the metrics of optimisers
_derivative   the answer with its derivative; _settings: what is asked of a step
_certified    the answer on the device: status and residuals; _projection, _pivoting, _rows: what it stands on
_host         the answer by the step itself, called back
"""

from ._direction import ConstrainedDirection as ConstrainedDirection
from ._direction import constrained_direction as constrained_direction

__all__ = ["ConstrainedDirection", "constrained_direction"]
