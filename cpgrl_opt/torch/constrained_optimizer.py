"""Any optimiser of PyTorch under constraints: it proposes, and what it proposes is projected in its own metric.

    Δ = what the optimiser would do;   Δ′ = argmin ½‖Δ′ − Δ‖²_H   s.t.   J Δ′ ≥ what the formulation demands

So nothing behind the projection can undo it, momentum and weight decay included. H is in `proposal_metric`. Where
M = H the problem is that of `ConstrainedStep` with step_size = 1, whose formulations, rules and fallbacks hold.
"""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch

from ..formulation import FORMULATIONS
from ..linearization import Linearization
from ..step import ConstrainedStep
from ..step_result import StepResult
from ..validation import require_finite
from . import loss_scale
from .channels import Channels, Gather, are_finite, linearize, take_step
from .parameters import read_parameters
from .proposal import Piece, Proposal, take_pieces
from .proposal_metric import Metric, scale_of
from .ranks import Average, local, read_gather, share
from .reverse_mode import require_dense
