"""What compiled estimators share that drive an environment's own kernels with a normalised Gaussian network."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from importlib import import_module
from typing import Any

import numpy as np
from numba import types
from numba.core import sigutils

from cpgrl_opt.arrays import Float
from envs.interface import RESET_SIGNATURE, STEP_SIGNATURE, ContinuousKernels, function_type, random_state

from ..interrupts import InterruptsHeld
from ..policies import NormalizedGaussianNetwork
from ..policies.normalized_gaussian_kernels import grid_of

# reset, step, constants, step limit, the network's counts, places, falls and σ, parameters (B, n) in θ's order,
# random states (B, 4).
_SHARED = "float64[::1], int64, int64[::1], float64[:, ::1], float64[:, ::1], float64, float64[:, ::1], uint64[:, ::1]"
# Δ (B, 1 + m, n) in θ's order, Σ r (B, 1 + m), steps (B,), events (B,), all filled.
_FILLED = "float64[:, :, ::1], float64[:, ::1], int64[::1], int64[::1]"


def rollout_signature(own: str) -> Any:
    """void(shared arguments, an estimator's own, what is filled); it loads from the disk cache in a new process."""
    arguments, _ = sigutils.normalize_signature(f"void({_SHARED}, {own}, {_FILLED})")
    return types.void(function_type(RESET_SIGNATURE), function_type(STEP_SIGNATURE), *arguments)


def first_class(kernel: Any, signature: str) -> Any:
    """The function compiled for `signature` with its address looked up, which a dispatcher repeats at every call."""
    arguments, _ = sigutils.normalize_signature(signature)
    return types.CompileResultWAP(kernel.overloads[arguments])


class ContinuousRollout:
    """B runs of a policy in a compiled environment, by a kernel of `rollout_signature`; carries the random states.

    A run's episodes draw from its random state alone: the reset, then for each step the action and the step, as the
    kernels take them. Raises ValueError when the policy's state or action does not fit the kernels.
    """

    carried = ("random_states",)

    def __init__(
        self,
        advance: Any,
        kernels: ContinuousKernels,
        policy: NormalizedGaussianNetwork,
        steps: int,
        streams: Sequence[np.random.SeedSequence],
    ) -> None:
        for what, found, wanted in (
            ("axes of the state", len(policy.counts), kernels.state_size),
            ("components of the action", policy.dimensions, kernels.action_size),
        ):
            if found != wanted:
                raise ValueError(f"policy should have {wanted} {what}, as the environment; found {found}")
        self.shape = (len(streams), kernels.reward_channels, len(policy.parameters))
        self.kernels, self.compiled = kernels, advance
        self.shared = (kernels.constants, min(int(steps), kernels.max_steps), *grid_of(policy), policy.deviation)
        self._look_up()
        self.random_states = np.array([random_state(stream) for stream in streams])

    def _look_up(self) -> None:
        """Addresses of machine code: of this process, so they are no part of what is pickled."""
        reset, step = first_class(self.kernels.reset, RESET_SIGNATURE), first_class(self.kernels.step, STEP_SIGNATURE)
        self.fixed = (reset, step, *self.shared)
        # Its entry point, since finding it anew by the types of twenty arguments takes longer than a short episode.
        (compiled,) = self.compiled.overloads.values()
        self.call = compiled.entry_point

    def __getstate__(self) -> dict[str, Any]:
        state = {name: value for name, value in vars(self).items() if name not in ("fixed", "call")}
        kernels = {field.name: _by_name(getattr(self.kernels, field.name)) for field in fields(self.kernels)}
        return {**state, "kernels": kernels, "compiled": _by_name(self.compiled)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        kernels = ContinuousKernels(**{name: _found(value) for name, value in state["kernels"].items()})
        vars(self).update({**state, "kernels": kernels, "compiled": _found(state["compiled"])})
        self._look_up()

    def advance(
        self, parameters: Float[np.ndarray, "B n"], own: tuple[Any, ...]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """One episode of each run in one compiled call; Δ, Σ r, steps, events, fresh arrays."""
        runs, channels, _ = self.shape
        filled = (
            np.empty(self.shape),
            np.empty((runs, channels)),
            np.empty(runs, dtype=np.int64),
            np.empty(runs, dtype=np.int64),
        )
        contiguous = np.ascontiguousarray(parameters, dtype=np.float64)
        with InterruptsHeld():
            self.call(*self.fixed, contiguous, self.random_states, *own, *filled)
        return filled


@dataclass(frozen=True)
class _Name:
    """Where a compiled function is found: numba would pickle its source, and compile it anew, half a minute long."""

    module: str
    name: str


def _by_name(value: Any) -> Any:
    named = _Name(str(getattr(value, "__module__", "")), str(getattr(value, "__name__", "")))
    return named if getattr(sys.modules.get(named.module), named.name, None) is value else value


def _found(value: Any) -> Any:
    return getattr(import_module(value.module), value.name) if isinstance(value, _Name) else value
