"""What a check raises, and how it is put to what may not come back."""

from collections.abc import Callable
from functools import partial, wraps
from typing import Any

import numpy as np

from cpgrl_opt.isolation import IsolationError, call

_LONGEST = 3600.0  # s, where only memory has a limit


class ContractBroken(AssertionError):  # noqa: N818 - the name says what happened
    """Something is not as it should be; the message says what should be and what was found."""


def require(holds: Any, should: str, found: object) -> None:
    """ContractBroken "… should …; found …" unless it holds."""
    if not holds:
        raise ContractBroken(f"{should}; found {found}")


def require_reward(wanted: np.ndarray, found: np.ndarray, should: str) -> None:
    """`require` the rewards wanted, to what float32 leaves of them; says whether only their order is wrong."""
    same, swapped = (
        wanted.shape == found.shape and np.allclose(one, other, rtol=1e-6, atol=1e-9)
        for one, other in ((wanted, found), (np.sort(wanted), np.sort(found)))
    )
    require(same, should, f"{found}{': the same numbers in another order of channels' if swapped else ''}")


def allow_limits(check: Callable[..., None]) -> Callable[..., None]:
    """The check with two more settings, `time_limit` in seconds and `memory_limit` in bytes.

    With either it runs in a process of its own, to which its arguments are pickled. What hangs, crashes or asks for
    more memory there is ContractBroken too, which says where it was.
    """

    @wraps(check)
    def checked(*given: Any, time_limit: float | None = None, memory_limit: int | None = None, **settings: Any) -> None:
        if time_limit is None and memory_limit is None:
            return check(*given, **settings)
        limit = _LONGEST if time_limit is None else time_limit
        try:
            call(partial(checked, *given, **settings), time_limit=limit, memory_limit=memory_limit)
        except IsolationError as lost:
            raise ContractBroken(f"{check.__name__} should come back; found {lost}") from lost

    return checked
