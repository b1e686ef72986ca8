"""JAX's arrays as NumPy sees them, without a copy where they lie on the CPU.

Called only with arrays of the caller's, who has imported jax: to import this does not.
"""

import sys
from typing import Any

import numpy as np


def is_jax(value: Any) -> bool:
    """Whether it is an array of JAX; one that is traced, under `jit` or `vmap`, too."""
    jax = sys.modules.get("jax")
    return jax is not None and isinstance(value, jax.Array)


def as_array(array: Any) -> np.ndarray:
    """What NumPy sees of it; ValueError for what is traced and has no numbers."""
    if isinstance(array, sys.modules["jax"].core.Tracer):
        raise ValueError(f"arrays of JAX should have numbers, outside of jit, vmap and grad; found {array}")
    return np.asarray(array)


def as_jax(part: np.ndarray, like: Any) -> Any:
    """The other way, in the shape of `like`."""
    numbers = part.view(like.dtype) if part.dtype == np.uint16 else part
    return sys.modules["jax"].numpy.asarray(numbers.reshape(like.shape))
