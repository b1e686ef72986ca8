"""What tells environments apart: the channels of their rewards, and the kernels that they hand to compiled code."""

from typing import Protocol, runtime_checkable

from .kernels import ContinuousKernels, FiniteKernel


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
