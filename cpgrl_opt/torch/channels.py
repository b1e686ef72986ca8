"""Objective and constraints of a loop → a `Linearization` in the signs of this package, and thresholds that go with it.

    g = −∇loss,   Jᵢ = −∇costᵢ (or ∇rewardᵢ),   slackᵢ = thresholdᵢ − costᵢ (or rewardᵢ − thresholdᵢ)

Reverse mode runs with the loss's own sign, since hooks of the parameters see its gradients; it is turned afterwards.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ..linearization import Linearization
from ..step import ConstrainedStep
from ..step_result import StepResult
from ..validation import finite_array, real_values, require_member, require_shape
from ..vectors import Sharded
from .ranks import local
from .reverse_mode import differentiate_all, differentiate_one

KINDS = ("cost", "reward")
Gather = Callable[[np.ndarray], Sequence[np.ndarray]]  # of `Sharded`
Loss = Any  # a tensor of one number, or a function that makes one


@dataclass(frozen=True, eq=False)
class Channels:
    """The objective and the constraints, checked; `names` where these came in a dict.

    thresholds, values: as they were given, in the order of the constraints; values None: those of the tensors.
    """

    objective: Loss | None
    constraints: list[Loss]
    names: tuple[Any, ...] | None
    thresholds: np.ndarray
    values: np.ndarray | None
    sign: float  # of the constraints

    @classmethod
    def read(cls, objective: Loss | None, constraints: Any, values: Any, thresholds: Any, kind: str) -> "Channels":
        """ValueError for what does not fit."""
        require_member("kind", kind, KINDS)
        names = tuple(constraints) if isinstance(constraints, Mapping) else None
        given = [*constraints.values()] if names is not None else _in_order(constraints)
        limits = _numbers("thresholds", thresholds, names, len(given))
        known = None if values is None else _numbers("values", values, names, len(given))
        return cls(objective, given, names, limits, known, -1.0 if kind == "cost" else 1.0)

    def name(self, channel: int) -> str:
        """As the caller would write it."""
        if channel == 0:
            return "objective"
        return f"constraints[{(channel - 1 if self.names is None else self.names[channel - 1])!r}]"

    def differentiate(
        self, parameters: list[Any], *, scale: float = 1.0, retain_graph: bool = False, batched: bool = False
    ) -> tuple[np.ndarray, list[list[Any]], list[Any]]:
        """(values, gradients, reached): of those parameters that any channel depends on.

        values (1 + m) and gradients are in this package's signs, the latter times scale. One reverse pass after
        another, or all at once where `batched`.
        """
        losses = [(i, each) for i, each in enumerate([self.objective, *self.constraints]) if each is not None]
        signs = [-1.0 if i == 0 else self.sign for i, _ in losses]
        found = np.zeros(1 + len(self.constraints))
        if batched:
            tensors = [self._evaluate(i, each) for i, each in losses]
            names = [self.name(i) for i, _ in losses]
            rows = differentiate_all(names, tensors, [scale * sign for sign in signs], parameters, retain_graph)
            values = [float(each.detach()) for each in tensors]
        else:
            rows, values = [], []
            last = max((k for k, (_, each) in enumerate(losses) if not callable(each)), default=-1)
            for k, (i, each) in enumerate(losses):
                tensor = self._evaluate(i, each)
                values.append(float(tensor.detach()))
                keep = not callable(each) and (k != last or retain_graph)
                rows.append(differentiate_one(self.name(i), tensor, scale * signs[k], parameters, keep))
        for (i, _), sign, value in zip(losses, signs, values, strict=True):
            found[i] = sign * value
        self._require_dependence(losses, rows)
        if self.values is not None:
            found[1:] = self.sign * self.values
        places = [k for k in range(len(parameters)) if any(row[k] is not None for row in rows)]
        zeros: dict[int, Any] = {}  # one for all channels that do not depend on it
        for row in rows:
            for k in places:
                if row[k] is None:
                    row[k] = zeros.setdefault(k, torch.zeros_like(local(parameters[k])))
        return found, [[row[k] for k in places] for row in rows], [parameters[k] for k in places]

    def require_finite(self, rows: list[list[Any]], first: int = 0) -> None:
        """ValueError that names the channel, the first row being that of the channel `first`."""
        for i, row in enumerate(rows, first):
            if not are_finite(row):
                raise ValueError(f"{self.name(i)} should have a finite gradient; found NaN or infinity")

    def evaluate(self) -> np.ndarray:
        """Values alone, in this package's signs."""
        if self.values is not None:
            return np.append(0.0, self.sign * self.values)
        found = [float(self._evaluate(1 + i, each).detach()) for i, each in enumerate(self.constraints)]
        return np.append(0.0, self.sign * np.array(found))

    def differentiate_again(self, parameters: list[Any]) -> list[list[Any]]:
        """The gradients alone, 0 where a channel does not depend on a parameter; graphs stay."""
        rows = []
        for i, each in enumerate([self.objective, *self.constraints]):
            tensor = self._evaluate(i, each)
            row = differentiate_one(self.name(i), tensor, self.sign if i else -1.0, parameters, not callable(each))
            rows.append([torch.zeros_like(p) if g is None else g for p, g in zip(parameters, row, strict=True)])
        return rows

    def slack_thresholds(self) -> np.ndarray:
        """In this package's signs."""
        return self.sign * self.thresholds

    def _evaluate(self, channel: int, loss: Loss) -> Any:
        if callable(loss):
            with torch.enable_grad():
                loss = loss()
        name = self.name(channel)
        if not isinstance(loss, torch.Tensor):
            raise ValueError(f"{name} should be a tensor, or a function that makes one; found {loss!r}")
        if loss.numel() != 1 or not loss.is_floating_point():
            raise ValueError(f"{name} should be one real number; found {loss.dtype} of shape {tuple(loss.shape)}")
        if not loss.requires_grad:
            raise ValueError(f"{name} should depend on the parameters; found a tensor without a graph")
        return loss

    def _require_dependence(self, losses: list[tuple[int, Loss]], rows: list[list[Any]]) -> None:
        for (i, _), row in zip(losses, rows, strict=True):
            if all(part is None for part in row):
                raise ValueError(f"{self.name(i)} should depend on the parameters; found no gradient at all")


def linearize(
    values: np.ndarray, gradients: list[list[Any]], channels: Channels, gather: Gather | None = None
) -> Linearization:
    """ValueError that names the channel whose gradient is not finite. gather: where these are parts, as `Sharded`."""
    try:
        given: Any = gradients if gather is None else Sharded(gradients[0], gradients[1:], gather=gather)
        return Linearization(values, given)
    except ValueError:
        channels.require_finite(gradients)
        raise


def are_finite(tensors: Iterable[Any]) -> bool:
    """No NaN and no infinity: seen in the sum of all, in a fiftieth of the time, unless finite numbers overflow it."""
    given = [each for each in tensors if each.numel()]
    if not given or bool(torch.stack([each.sum(dtype=torch.float32) for each in given]).sum().isfinite()):
        return True
    return all(bool(each.isfinite().all()) for each in given)


def take_step(step: ConstrainedStep, linearization: Linearization, channels: Channels, previous: Any) -> StepResult:
    """The step's result; ValueError that names the constraint that asks for a change beyond the parameters' dtype."""
    limits = channels.slack_thresholds()
    try:
        return step(linearization, limits, previous)
    except FloatingPointError as error:
        missing = np.maximum(-linearization.slack(limits), 0.0)
        lengths = linearization.vectors[0].lengths()[1:]
        asked = np.divide(missing, lengths, out=np.zeros(len(missing)), where=lengths > 0.0)
        if not asked.any():
            raise ValueError(f"the change of the parameters should be finite; found: {error}") from error
        k = int(np.argmax(asked))
        raise ValueError(
            f"{channels.name(1 + k)} should be restored by a change that is finite in the parameters' dtype; found "
            f"that it misses its threshold by {missing[k]:.3g}, and its gradient is {lengths[k]:.3g} long: "
            "max_restoration limits what a step restores"
        ) from error


def _in_order(constraints: Any) -> list[Loss]:
    if isinstance(constraints, torch.Tensor):
        if constraints.ndim != 1:
            raise ValueError(
                f"constraints should be a list, a dict or one axis; found shape {tuple(constraints.shape)}"
            )
        return [*constraints.unbind()]
    if not isinstance(constraints, Sequence) or isinstance(constraints, str):
        raise ValueError(f"constraints should be a list or a dict of tensors; found {constraints!r}")
    return [*constraints]


def _numbers(name: str, given: Any, names: tuple[Any, ...] | None, count: int) -> np.ndarray:
    """(m,), in the order of the constraints."""
    if isinstance(given, Mapping):
        if names is None or {*given} != {*names}:
            wanted = "in order as constraints are" if names is None else f"named {', '.join(map(str, names))}"
            raise ValueError(f"{name} should be {wanted}; found {', '.join(map(str, given))}")
        given = [given[each] for each in names]
    numbers = np.atleast_1d(real_values(name, given)) if count else np.zeros(np.shape(given))
    require_shape(name, numbers, (count,))
    return finite_array(name, numbers, 1)
