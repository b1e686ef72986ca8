"""How rl's kernels are compiled. Only modules that hold kernels import this one, for it imports numba."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

import cpgrl_opt
from cpgrl_opt.machine_code import compile_function
from envs import interface
from envs.interface.kernel_cache import forget_outdated_kernels

# What only kernels call: compiled with them, and neither compiled nor loaded where a kernel comes from the cache.
helper = numba.njit(nogil=True, error_model="numpy")


def kernel(signature: str, **options: Any) -> Callable[[Any], Any]:
    """Compiled, or loaded from the disk cache, as its module is imported."""
    return lambda function: compile_function(signature, function, **options)


_HERE = Path(__file__).parent
_FOLDERS = [_HERE / "policies", _HERE / "drivers", _HERE / "estimators"]


def _sources() -> list[Path]:
    steps = Path(cpgrl_opt.__file__).parent
    inlined = [*_FOLDERS, Path(interface.__file__).parent, steps / "solvers" / "compiled"]
    alone = [Path(__file__), _HERE / "_late_kernels.py", steps / "direct_step.py"]
    return [*alone, *(source for folder in inlined for source in folder.glob("*.py"))]


forget_outdated_kernels(_FOLDERS, _sources())  # before any of them is loaded
