"""One source in two forms: Python as it stands, at once, and machine code, for whoever solves more than a few problems.

Loading machine code takes 0.6 s from numba's disk cache; making it takes 4 s for the direct pass and 10 s for the
thorough kernel. The interpreter needs 0.3 ms for a problem of nine parameters, where machine code needs 1 µs. So the
first calls of a process are interpreted, if they are small, and one problem does not wait for a compiler; few calls,
so that whoever measures times does not measure the interpreter. Both forms do the same operations on float64 in the
same order, without fastmath: their answers are the same, bit for bit.
"""

from collections.abc import Callable
from functools import cache, cached_property
from types import FunctionType
from typing import Any

import numpy as np

INTERPRETED_WORK = 50_000  # of a call, in what `work` counts; the interpreter takes 1 to 2 µs for each

_KERNELS: set[Any] = set()


def kernel(function: Any) -> Any:
    """Marks a helper that entry points call; machine code of it is part of theirs."""
    _KERNELS.add(function)
    return function


@cache
def _compiled(function: FunctionType) -> Any:
    """The helper for numba: a twin whose helpers are compiled too, since numba looks up its globals."""
    from numba import njit

    return njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)(_twin(function))


def _twin(function: FunctionType) -> FunctionType:
    """The same code, in which the names of kernels mean their compiled forms."""
    known = function.__globals__
    named = {name: known[name] for name in function.__code__.co_names if isinstance(known.get(name), FunctionType)}
    compiled = {name: _compiled(value) for name, value in named.items() if value in _KERNELS}
    return FunctionType(function.__code__, {**known, **compiled}, function.__name__)


class EntryPoint:
    """A kernel to be called from Python; it fills its last arguments in, and raises for no number in the others."""

    def __init__(self, function: FunctionType, signature: str, calls_to_interpret: int) -> None:
        self.function = function
        self.signature = signature
        self.calls_to_interpret = calls_to_interpret

    @cached_property
    def machine_code(self) -> Any:
        """Compiled for the signature, or loaded from numba's disk cache; all calls go there from then on."""
        from numba import njit

        self.calls_to_interpret = 0
        return njit(self.signature, cache=True, error_model="numpy", no_cfunc_wrapper=True)(_twin(self.function))

    def __call__(self, *arguments: Any) -> None:
        """In the form that suits the work so far."""
        if self.calls_to_interpret > 0 and work(arguments) <= INTERPRETED_WORK:
            self.calls_to_interpret -= 1
            with np.errstate(all="ignore"):  # numba knows no warnings
                self.function(*arguments)
            return
        self.machine_code(*arguments)


def work(arguments: tuple[Any, ...]) -> int:
    """50 + (m + 1)²n, as inner products of rows and the gradient take; J is the only matrix."""
    [(m, n)] = (np.shape(array) for array in arguments if np.ndim(array) == 2)
    return 50 + int((m + 1) ** 2 * n)


def entry_point(signature: str, *, interpreted_calls: int) -> Callable[[Any], EntryPoint]:
    """Decorates the kernel that Python calls: numba's signature of it, how many calls are interpreted at first."""
    return lambda function: EntryPoint(function, signature, interpreted_calls)
