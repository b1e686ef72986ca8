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
from .step_info import StepInfo, describe
from .tracing import run_uncompiled


class _Asked(NamedTuple):
    """Constraints, their values in this package's signs, and their gradients, each by the ids of parameters."""

    channels: Channels
    values: np.ndarray
    gradients: list[dict[int, Any]]


class ConstrainedOptimizer(torch.optim.Optimizer):  # type: ignore[misc]
    """An optimiser whose changes keep slack + J·Δθ as large as the step's formulation demands, to first order.

        optimizer = ConstrainedOptimizer(torch.optim.Adam(net.parameters()), step)
        optimizer.zero_grad()
        optimizer.constrain([cost_1, cost_2], thresholds=[0.1, 0.35])
        loss.backward()
        optimizer.step()                                               # and optimizer.info says what happened

    Parameters
    ----------
    optimizer : of `torch.optim`. Groups, state, schedulers and hooks are its own.
    step : how constraints are met. Its step_size is not asked for: the optimiser says how far.
    metric : a function of a parameter that returns H there, positive, a number or a tensor of its shape, asked after
        the optimiser's step; by default the optimiser's own.
    gather : where each process has a part of the parameters of one model, as of `constrained_backward`.
    average : where each has a share of the data, as of `constrained_backward`: for gradients and values of constraints.
        The objective's are averaged by `DistributedDataParallel`, in loss.backward().

    Where nothing is certified the parameters stay, and where nothing meets the constraints they are violated least;
    `info.status` says so. The optimiser's moments are those of the objective's gradient alone. What rounding to the
    parameters' dtype adds, up to half a unit in the last place of each, stands in no number of `info`.
    """

    def __init__(
        self,
        optimizer: Any,
        step: ConstrainedStep,
        *,
        metric: Metric | None = None,
        gather: Gather | None = None,
        average: Average | None = None,
    ) -> None:
        if not isinstance(optimizer, torch.optim.Optimizer) or isinstance(optimizer, ConstrainedOptimizer):
            raise ValueError(f"optimizer should be one of torch.optim; found {optimizer!r}")
        if not isinstance(step, ConstrainedStep):
            raise ValueError(f"step should be a ConstrainedStep; found {step!r}")
        if step.radius is not None:
            raise ValueError(f"step should have no radius, since the optimiser says how far; found {step.radius!r}")
        if step.metric is not None:
            raise ValueError("step should have no metric, since the optimiser has its own; found one")
        if metric is not None and not callable(metric):
            raise ValueError(f"metric should be a function of a parameter; found {metric!r}")
        self.optimizer, self.metric, self.gather, self.average = optimizer, metric, gather, average
        self.info: StepInfo | None = None
        self._step = replace(step, step_size=1.0)
        self._asked: _Asked | None = None
        self._gather = gather  # or that of shards, where the parameters are
        self._keeps_first = False
        self._previous: np.ndarray | None = None

    @run_uncompiled
    def constrain(
        self,
        constraints: Any,
        *,
        values: Any = None,
        thresholds: Any,
        kind: str = "cost",
        retain_graph: bool = True,
        batched: bool = False,
        scaler: Any = None,
    ) -> None:
        """Says what the next `step` has to keep: gradients are taken here, at the parameters as they are.

        Arguments as of `constrained_backward`. retain_graph: True, so that loss.backward() may follow. Where a closure
        calls this more than once in a step, the first time counts.
        """
        if self._keeps_first and self._asked is not None:
            return
        self._asked = None  # of what was asked before nothing stays, should this fail
        channels, scale = Channels.read(None, constraints, values, thresholds, kind), loss_scale.scale_of(scaler)
        moving = read_parameters(self.param_groups)
        settings: dict[str, Any] = {"scale": scale, "retain_graph": retain_graph, "batched": batched}
        self._gather = read_gather(moving, self.average, self.gather, batched=batched, scaler=scaler)
        found, rows, reached = share(channels.differentiate(moving, **settings), moving, self.average, self._gather)
        if loss_scale.overflows(rows, scaler):
            self.info = loss_scale.skip(moving, channels, found)
            return
        loss_scale.unscale(rows, scale)
        if self._gather is None:
            channels.require_finite(rows, first=1)
        else:
            self._require_finite([part for row in rows for part in row], "gradients of constraints")
        require_finite("values", found)
        gradients = [{id(each): part for each, part in zip(reached, row, strict=True)} for row in rows]
        self._asked = _Asked(replace(channels, constraints=[]), found, gradients)  # their graphs need not stay

    @run_uncompiled
    def step(self, closure: Callable[[], Any] | None = None) -> Any:
        """The optimiser's step, projected; returns what the optimiser returns.

        ValueError where `constrain` was not called before, or by the closure, and where a gradient or the proposal is
        not finite; DirectionError if `step.on_failure` says so. Then the parameters are what they were, and what was
        asked is forgotten; the optimiser's moments may know the step's gradient, which is finite. Post-step hooks of
        the optimiser run after the projection.
        """
        hooks, pieces = getattr(self.optimizer, "_optimizer_step_post_hooks", OrderedDict()), list[Piece]()
        self._keeps_first = closure is not None
        try:
            if closure is None:
                self._require_asked()
                self._require_gradients()
            else:
                self._asked = None
            pieces = self._pieces()
            self.optimizer._optimizer_step_post_hooks = OrderedDict()
            loss = self.optimizer.step(None if closure is None else self._checked(closure))
            with torch.no_grad():
                self._project(pieces, self._require_asked())
        except BaseException:
            with torch.no_grad():
                for piece in pieces:
                    piece.put(piece.before)
            raise
        finally:
            self._asked, self._keeps_first = None, False
            self.optimizer._optimizer_step_post_hooks = hooks
        for hook in hooks.values():
            hook(self.optimizer, (self.optimizer, closure), {})
        return loss

    def _project(self, pieces: list[Piece], asked: _Asked) -> None:
        channels, values, rows = asked
        slack = values[1:] - channels.slack_thresholds()
        known = self._previous if self._previous is not None and len(self._previous) == len(slack) else None
        moving = [piece for piece in pieces if float(piece.group.get("lr", 1.0)) > 0.0]
        if not moving:
            result = self._stay(values, slack, channels, known)
        else:
            try:
                proposal = Proposal(moving, [scale_of(self.optimizer, piece, self.metric) for piece in moving])
                given = linearize(values, proposal.whiten(rows), channels, self._gather)
            except ValueError:
                self._require_finite(self._parameters(), "the optimiser's proposal")
                raise
            result = take_step(self._step, given, channels, known)
            if result.active.any() or result.counts["skipped"] or result.counts["infeasible"]:
                proposal.replace(result.change)
        self.info = describe(result, slack, channels.names)
        self._previous = self.info.previous

    def _stay(self, values: np.ndarray, slack: np.ndarray, channels: Channels, known: Any) -> StepResult:
        """Of a step in which no parameter may move, at the start of a warm-up: infeasible if it is to restore.

        Then μ = 1 of the constraints to be restored is the proof: 0 = Jᵀμ and μ·demand > 0.
        """
        nothing = Linearization(values, np.zeros((len(values), 1)))
        result = take_step(self._step, nothing, channels, known)
        is_missed = float(self._step.restoration_rate) * np.maximum(-slack, 0.0) > 0.0
        if not FORMULATIONS[self._step.formulation].takes_all:
            is_missed &= result.active
        if not is_missed.any():
            return result
        counts = {**result.counts, "infeasible": np.array(1)}
        proof = {"multipliers": is_missed.astype(float), "residuals": None, "stationary": np.array(False)}
        active = is_missed if FORMULATIONS[self._step.formulation].takes_all else result.active
        return replace(result, counts=counts, active=active, **proof)

    def _checked(self, closure: Callable[[], Any]) -> Callable[[], Any]:
        """The closure, which ends where a gradient is not finite: NaN would stay in the optimiser's moments."""

        def evaluate() -> Any:
            loss = closure()
            self._require_gradients()
            return loss

        return evaluate

    def _pieces(self) -> list[Piece]:
        with torch.no_grad():
            return take_pieces(self.param_groups)

    def _parameters(self) -> list[Any]:
        return [each for group in self.param_groups for each in group["params"] if each.requires_grad]

    def _require_asked(self) -> _Asked:
        if self._asked is None:
            raise ValueError("constrain should be called before each step; found that it was not")
        return self._asked

    def _require_gradients(self) -> None:
        gradients = [each.grad for each in self._parameters()]
        require_dense("objective", gradients)
        self._require_finite([each for each in gradients if each is not None], "gradients of the objective")

    def _require_finite(self, tensors: list[Any], name: str) -> None:
        is_finite = are_finite(local(each) for each in tensors)
        if self._gather is not None:  # what one rank sees in its part is an error on all, who would wait for it
            is_finite = min(self._gather(np.array([float(is_finite)])))[0] > 0.0
        if not is_finite:
            raise ValueError(f"{name} should be finite; found NaN or infinity")

    @property
    def param_groups(self) -> Any:
        """The optimiser's."""
        return self.optimizer.param_groups

    @property
    def state(self) -> Any:
        """The optimiser's."""
        return self.optimizer.state

    def zero_grad(self, set_to_none: bool = True) -> None:
        """As the optimiser does."""
        self.optimizer.zero_grad(set_to_none)

    def add_param_group(self, param_group: dict[str, Any]) -> None:
        """As the optimiser does."""
        self.optimizer.add_param_group(param_group)

    def state_dict(self) -> dict[str, Any]:
        """The optimiser's, and the last active set, for rules with memory."""
        active = None if self._previous is None else self._previous.tolist()
        return {**self.optimizer.state_dict(), "active": active}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """The optimiser's own will do."""
        state = dict(state_dict)
        active = state.pop("active", None)
        self.optimizer.load_state_dict(state)
        self._previous = None if active is None else np.array(active, np.bool_)

    def __getattr__(self, name: str) -> Any:
        if name == "optimizer":  # not there yet, while a copy is made
            raise AttributeError(name)
        return getattr(self.optimizer, name)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_asked": None, "_gather": self.gather}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.optimizer!r}, {self._step!r})"
