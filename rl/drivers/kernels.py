"""What compiled drivers are made of: numba's types of `interface`, and its functions for use in kernels."""

import functools
from typing import Any

import numba
import numpy as np
from numba import types
from numba.core import sigutils

from envs.interface import function_type

from .._kernels import kernel
from ..interrupts import InterruptsHeld
from . import interface
from .interface import Batch, CompiledStep, RuleStep, step_signature

__all__ = ["account", "close_run", "driver_signature", "kernel", "open_run", "play"]

_VECTOR, _ROWS, _STACK = (types.Array(types.float64, axes, "C") for axes in (1, 2, 3))
_INTEGERS, _FLAGS = types.Array(types.int64, 1, "C"), types.Array(types.boolean, 1, "C")
_BATCH = types.NamedTuple(
    (
        _VECTOR, _ROWS, types.int64, _FLAGS, types.boolean, types.int64, types.float64,
        _ROWS, _VECTOR, _STACK,
        _VECTOR, _ROWS, _ROWS,
        _STACK, _ROWS, _ROWS, _ROWS, _INTEGERS, _INTEGERS,
    ),
    Batch,
)  # fmt: skip
_STEP = step_signature()

open_run, account, close_run = (
    numba.njit(function, nogil=True, error_model="numpy", inline="always")
    for function in (interface.open_run, interface.account, interface.close_run)
)


def driver_signature(arguments: str, *functions: str) -> Any:
    """void(a rule's step, functions by their signatures, arguments, batch); it loads from the disk cache."""
    own, _ = sigutils.normalize_signature(f"void({arguments})")
    return types.void(types.FunctionType(_STEP), *map(function_type, functions), *own, _BATCH)


@functools.cache
def address_of(compiled: Any, signature: Any) -> Any:
    """A compiled function as an argument of another; a dispatcher would look its address up at every call."""
    arguments, _ = sigutils.normalize_signature(signature)
    return types.CompileResultWAP(compiled.overloads[arguments])


@functools.cache
def _entry_point(advance: Any) -> Any:
    """Finding it anew by the types of the arguments takes longer than a short episode."""
    (found,) = advance.overloads.values()
    return found.entry_point


def play(advance: Any, step: RuleStep, functions: dict[str, Any], *arguments: Any) -> None:
    """An episode of each run in one call: `advance` for a compiled rule, the same code interpreted for a plain one.

    functions: compiled ones that `advance` is handed after the rule, by their signatures.
    """
    if not isinstance(step, CompiledStep):
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows shows in the estimate
            advance.py_func(step, *functions.values(), *arguments)
        return
    addresses = [address_of(function, signature) for signature, function in functions.items()]
    with InterruptsHeld():
        _entry_point(advance)(address_of(step.machine_code, _STEP), *addresses, *arguments)
