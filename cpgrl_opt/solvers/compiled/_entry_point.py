"""One source in two forms: Python as it stands, at once, and machine code, for whoever solves more than a few problems.

Loading machine code takes 0.6 s from numba's disk cache; making it takes 6 s for the direct pass and 9 s for the
thorough kernel. The interpreter needs 0.3 ms for a problem of nine parameters, machine code half a microsecond. So the
first calls of a process are interpreted, if they are small, and one problem does not wait for a compiler; few calls,
so that whoever measures times does not measure the interpreter. Both forms do the same operations on float64 in the
same order, without fastmath: their answers are the same, bit for bit.
"""

from collections.abc import Callable
from functools import cache, cached_property
from types import FunctionType
from typing import Any

import numpy as np

from ...machine_code import CompiledLate, compile_function

# numba's signatures: an array that is read, of a type and a number of axes; and g, J, b and E of an entry point.
READ = "Array({}, {}, 'C', readonly=True)"
GIVEN = ", ".join(READ.format(*each) for each in (("f8", 1), ("f8", 2), ("f8", 1), ("b1", 1)))

_INLINED: dict[Any, bool] = {}  # kernels, and whether their code is copied to where they are called


def kernel(function: Any) -> Any:
    """Marks a helper that entry points call; machine code of it is part of theirs."""
    _INLINED[function] = False
    return function


def inlined(function: Any) -> Any:
    """As `kernel`, for helpers that do less than a call costs: an array is handed on as seven to nine numbers.

    The direct pass takes 2/3 of the time so; the thorough kernel would take twice as long to compile.
    """
    _INLINED[function] = True
    return function


@cache
def _compiled(function: FunctionType) -> Any:
    """The helper for numba: a twin whose helpers are compiled too, since numba looks up its globals."""
    from numba import njit

    wrappers = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return njit(error_model="numpy", forceinline=_INLINED[function], **wrappers)(_twin(function))


def _twin(function: FunctionType) -> FunctionType:
    """The same code, in which the names of kernels mean their compiled forms."""
    known = function.__globals__
    named = {name: known[name] for name in function.__code__.co_names if isinstance(known.get(name), FunctionType)}
    compiled = {name: _compiled(value) for name, value in named.items() if value in _INLINED}
    return FunctionType(function.__code__, {**known, **compiled}, function.__name__)


class EntryPoint(CompiledLate):
    """A kernel to be called from Python; it fills its last arguments in, and raises for no number in the others."""

    def __init__(self, signature: str, function: FunctionType, calls: int, work: int) -> None:
        super().__init__(signature, function)
        self.calls_to_interpret, self.work_to_interpret = calls, work
        self.run: Callable[..., Any] = self  # machine code itself, once there is any: a frame less on the way

    @cached_property
    def machine_code(self) -> Any:
        """Compiled for the signature, or loaded from numba's disk cache; all calls go there from then on."""
        self.calls_to_interpret = 0
        self.run = compile_function(self.signature, _twin(self.function), no_cfunc_wrapper=True)
        return self.run

    def __call__(self, *arguments: Any) -> Any:
        """In the form that suits the work so far."""
        if self.calls_to_interpret > 0 and (more := work(arguments)) <= self.work_to_interpret:
            self.calls_to_interpret -= 1
            self.work_to_interpret -= more
            with np.errstate(all="ignore"):  # numba knows no warnings
                return self.function(*arguments)
        return self.machine_code(*arguments)


def work(arguments: tuple[Any, ...]) -> int:
    """50 + (m + 1) n (min(m, n) + 1), as an orthonormal basis of the rows takes; J is the only matrix."""
    [(m, n)] = (np.shape(array) for array in arguments if np.ndim(array) == 2)
    return 50 + int((m + 1) * n * (min(m, n) + 1))


def entry_point(signature: str, *, interpreted: tuple[int, int] = (0, 0)) -> Callable[[Any], EntryPoint]:
    """Decorates the kernel that Python calls: numba's signature of it, and what is interpreted at first.

    interpreted: the most calls, and the most `work` of them together.
    """
    return lambda function: EntryPoint(signature, function, *interpreted)
