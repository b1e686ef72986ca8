"""What stands in a training loop between the losses and the changed parameters, contender by contender.

Each function is the glue that a user writes: it takes a network's parameters and settings, and returns
`update(loss, costs, thresholds)`: loss a tensor of one number, costs and thresholds (m,); the tensors have the values
and the gradients. Packages are imported where they are used, so that one that is missing costs its lines only.
"""

import inspect
from collections.abc import Callable
from typing import Any

import torch

from cpgrl_opt import ConstrainedStep
from cpgrl_opt.torch import ConstrainedOptimizer, constrained_backward

Update = Callable[[Any, Any, Any], Any]


def adam(parameters: list[Any], rate: float) -> Update:
    """The objective alone."""
    optimizer = torch.optim.Adam(parameters, lr=rate)

    def update(loss: Any, costs: Any, thresholds: Any) -> None:  # noqa: ARG001
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    return update


def backward_and_sgd(parameters: list[Any], rate: float, formulation: str) -> Update:
    """`constrained_backward`, whose change SGD makes as it is."""
    step = ConstrainedStep(formulation=formulation, step_size=rate, restoration_rate=0.5)
    optimizer = torch.optim.SGD(parameters, lr=rate)

    def update(loss: Any, costs: Any, thresholds: Any) -> None:
        optimizer.zero_grad()
        constrained_backward(loss, costs, thresholds=thresholds, parameters=parameters, step=step)
        optimizer.step()

    return update


def backward_and_adam(parameters: list[Any], rate: float, formulation: str) -> Update:
    """The same under Adam, which changes the change."""
    step = ConstrainedStep(formulation=formulation, step_size=rate, restoration_rate=0.5)
    optimizer = torch.optim.Adam(parameters, lr=rate)

    def update(loss: Any, costs: Any, thresholds: Any) -> None:
        optimizer.zero_grad()
        constrained_backward(loss, costs, thresholds=thresholds, parameters=parameters, step=step)
        optimizer.step()

    return update


def constrained_adam(parameters: list[Any], rate: float, formulation: str) -> Update:
    """`ConstrainedOptimizer`, which projects what Adam proposes."""
    step = ConstrainedStep(formulation=formulation, restoration_rate=0.5)
    optimizer = ConstrainedOptimizer(torch.optim.Adam(parameters, lr=rate), step)

    def update(loss: Any, costs: Any, thresholds: Any) -> None:
        optimizer.zero_grad()
        optimizer.constrain(costs, thresholds=thresholds)
        loss.backward()
        optimizer.step()

    return update


def aggregate_jacobian(parameters: list[Any], rate: float, aggregator: str) -> Update:
    """TorchJD has no thresholds: a cost is one of its losses while it is violated, else a row of zeros."""
    from torchjd import aggregation
    from torchjd.autojac import backward, jac_to_grad

    optimizer, combine = torch.optim.Adam(parameters, lr=rate), getattr(aggregation, aggregator)()

    def update(loss: Any, costs: Any, thresholds: Any) -> None:
        optimizer.zero_grad()
        violation = (costs - thresholds).relu()
        backward([loss, violation], inputs=parameters)
        jac_to_grad(parameters, combine)
        optimizer.step()

    return update


def lagrangian(parameters: list[Any], rate: float, dual_rate: float, gain: float | None = None, m: int = 2) -> Update:
    """Cooper: multipliers by gradient ascent, or with a gain by PI control: proportional over integral, ν = 0."""
    import cooper

    class Problem(cooper.ConstrainedMinimizationProblem):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            multiplier = cooper.multipliers.DenseMultiplier(num_constraints=m)
            self.limits = cooper.Constraint(cooper.ConstraintType.INEQUALITY, multiplier=multiplier)

        def compute_cmp_state(self, loss: Any, violation: Any) -> Any:
            return cooper.CMPState(loss, {self.limits: cooper.ConstraintState(violation)})

    problem = Problem()
    duals = {"params": problem.dual_parameters(), "lr": dual_rate, "maximize": True}
    dual = torch.optim.SGD(**duals) if gain is None else cooper.optim.nuPI(**duals, Kp=gain)
    primal = torch.optim.Adam(parameters, lr=rate)
    optimizer = cooper.optim.SimultaneousOptimizer(problem, primal, dual)

    def update(loss: Any, costs: Any, thresholds: Any) -> None:
        optimizer.roll({"loss": loss, "violation": costs - thresholds})

    return update


def count_lines(glue: Callable[..., Update]) -> int:
    """Lines of code of a contender, its imports with them, without what only makes it a function of this file."""
    lines = [line.strip() for line in inspect.getsource(glue).splitlines()[1:]]
    return sum(bool(line) and not line.startswith(('"""', "def update", "return update", "#")) for line in lines)


_RATES = (0.001, 0.003, 0.01, 0.02, 0.03, 0.1)
_FORMULATIONS = ("restoring", "linearized")
_OURS = [(rate, formulation) for rate in (0.003, 0.01, 0.03) for formulation in _FORMULATIONS]
_ASCENT = [(rate, dual) for rate in (0.003, 0.01, 0.03) for dual in (0.1, 1.0)]
_CONTROL = [(rate, *dual) for rate in (0.003, 0.01, 0.03) for dual in ((0.1, 10.0), (1.0, 1.0))]
# By name: the glue, the settings that are tried, as many for each, and the package that it needs.
CONTENDERS: dict[str, tuple[Callable[..., Update], list[tuple[Any, ...]], str]] = {
    "Adam, no constraints": (adam, [(rate,) for rate in _RATES], "torch"),
    "ours: constrained_backward, SGD": (backward_and_sgd, _OURS, "torch"),
    "ours: constrained_backward, Adam": (backward_and_adam, _OURS, "torch"),
    "ours: ConstrainedOptimizer(Adam)": (constrained_adam, _OURS, "torch"),
    "TorchJD: UPGrad, Adam": (aggregate_jacobian, [(rate, "UPGrad") for rate in _RATES], "torchjd"),
    "TorchJD: DualProj, Adam": (aggregate_jacobian, [(rate, "DualProj") for rate in _RATES], "torchjd"),
    "Cooper: Lagrangian, Adam": (lagrangian, _ASCENT, "cooper"),
    "Cooper: PI, Adam": (lagrangian, _CONTROL, "cooper"),
}
