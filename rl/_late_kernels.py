"""Kernels in modules that do not import numba: compiled, or loaded from the cache, when they are first called."""

from collections.abc import Callable
from functools import cached_property
from typing import Any

from cpgrl_opt.machine_code import CompiledLate


class LateKernel(CompiledLate):
    """Compiled or loaded when it is first called, from Python or from another kernel; pickled by its name."""

    def __init__(self, signature: str, function: Callable[..., Any], **options: Any) -> None:
        super().__init__(signature, function)  # type: ignore[arg-type]
        self.options = options
        self.__module__, self.__doc__ = function.__module__, function.__doc__

    @cached_property
    def machine_code(self) -> Any:
        """The compiled function itself."""
        from ._kernels import kernel  # numba loads here

        return kernel(self.signature, **self.options)(self.function)

    @property
    def _numba_type_(self) -> Any:
        """By which numba knows what a kernel calls."""
        return self.machine_code._numba_type_

    def __reduce__(self) -> str:
        return str(self.function.__qualname__)


def late_kernel(signature: str, **options: Any) -> Callable[[Callable[..., Any]], LateKernel]:
    """Decorates what compiled steps call."""
    return lambda function: LateKernel(signature, function, **options)


# Sums in any order, so that they fill vector registers; NaN and infinities keep their meaning.
@late_kernel("float64(float64[::1], int64, float64[::1])", fastmath={"reassoc", "nsz", "contract"})
def inner(vector, place, values):  # type: ignore[no-untyped-def]
    """wᵀψ."""
    window, total = vector[place : place + values.size], 0.0
    for j in range(values.size):
        total += window[j] * values[j]
    return total
