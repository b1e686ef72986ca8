"""What `torch.compile` may surround and should not look into: a certificate is no graph of tensors."""

from collections.abc import Callable
from functools import wraps
from typing import Any

import torch


def run_uncompiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function, which compiled code calls as it is."""

    @wraps(function)
    def call(*arguments: Any, **settings: Any) -> Any:
        if torch.compiler.is_compiling():  # asked here, for to disable it beforehand imports the compiler, 3 s
            return torch.compiler.disable(function)(*arguments, **settings)
        return function(*arguments, **settings)

    return call
