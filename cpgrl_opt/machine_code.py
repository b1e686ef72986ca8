"""Machine code of functions, cached on disk where there is a folder for it. Calling it imports numba."""

import warnings
from types import FunctionType
from typing import Any

import numpy as np


def compiled(signature: str, function: FunctionType, **options: bool) -> Any:
    """numba's function for the signature; division by zero gives an infinity or NaN.

    Warns, and compiles for this process alone, where numba finds no folder that it may write its cache into. Under
    NUMBA_DISABLE_JIT the function itself, silent about overflow as machine code is.
    """
    from numba import njit

    settings: dict[str, Any] = {"error_model": "numpy", **options}
    try:
        machine_code = njit(signature, cache=True, **settings)(function)
    except RuntimeError as error:
        if "no locator" not in str(error):
            raise
        warnings.warn(
            f"{function.__name__} is compiled for this process alone, some seconds: there is no folder that numba may "
            "write its cache into. Set NUMBA_CACHE_DIR to one.",
            RuntimeWarning,
            stacklevel=2,
        )
        machine_code = njit(signature, **settings)(function)
    return np.errstate(all="ignore")(machine_code) if machine_code is function else machine_code
