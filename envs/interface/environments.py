"""What tells environments apart: the channels of their rewards, and the kernels that they hand to compiled code."""

from typing import Any, Protocol, runtime_checkable

from .kernels import ContinuousKernels, FiniteKernel
from .overrides import declaring_class, list_overrides


@runtime_checkable
class VectorReward(Protocol):
    """Rewards are vectors: channel 0 intrinsic, channels 1 … m extrinsic."""

    @property
    def reward_channels(self) -> int:
        """1 + m."""
        ...


@runtime_checkable
class FiniteEnvironment(VectorReward, Protocol):
    """An environment that hands a finite MDP to compiled code."""

    def finite_kernel(self) -> FiniteKernel:
        """Fresh arrays."""
        ...


@runtime_checkable
class ContinuousEnvironment(VectorReward, Protocol):
    """An environment that hands compiled reset and step functions over."""

    def continuous_kernels(self) -> ContinuousKernels:
        """Fresh constants, compiled functions."""
        ...


def finite_kernel_of(environment: Any) -> FiniteKernel | None:
    """The finite MDP that stands for an environment; None where nothing but its own `step` does.

    A kernel stands for the class that declares `finite_kernel`, and for a subclass that leaves that class's code alone
    (`list_overrides`) or declares a kernel of its own. A subclass with its own `step` or reward, a wrapper and a
    patched instance are trained by what their `step` says.

    Raises
    ------
    ValueError
        Where the kernel does not stand for the environment, and there is no `reset` and `step` either.
    """
    kernel: FiniteKernel | None = _kernels_of(environment, FiniteEnvironment, "finite_kernel", FiniteKernel)
    return kernel


def continuous_kernels_of(environment: Any) -> ContinuousKernels | None:
    """The compiled functions that stand for an environment, by the same rule as `finite_kernel_of`."""
    kernels: ContinuousKernels | None = _kernels_of(
        environment, ContinuousEnvironment, "continuous_kernels", ContinuousKernels
    )
    return kernels


def _kernels_of(environment: Any, protocol: type, name: str, kind: type) -> Any:
    if not isinstance(environment, protocol):
        return None
    if name not in getattr(environment, "__dict__", {}):  # else the instance declares kernels itself
        owner = declaring_class(environment, name)
        if owner is None:  # lent by __getattr__ from another environment, whose step is not this one's
            return None
        if changed := list_overrides(environment, owner):
            return _require_own_step(environment, f"{owner.__name__}.{name}", changed)
    kernels = getattr(environment, name)()
    if not isinstance(kernels, kind):
        raise ValueError(f"{name} should return a {kind.__name__}; found {kernels!r}")
    return kernels


def _require_own_step(environment: Any, inherited: str, changed: list[str]) -> None:
    """None where `reset` and `step` remain to train by; else ValueError."""
    if all(callable(getattr(environment, name, None)) for name in ("reset", "step")):
        return
    name = inherited.split(".")[-1]
    raise ValueError(
        f"{type(environment).__name__} should declare its own {name}, or have reset and step, since it has its own "
        f"{', '.join(changed)}; found only the {inherited} that it inherits, which knows nothing of that"
    )
