"""What a check raises."""

from typing import Any


class ContractBroken(AssertionError):  # noqa: N818 - the name says what happened
    """Something is not as it should be; the message says what should be and what was found."""


def require(holds: Any, should: str, found: object) -> None:
    """ContractBroken "… should …; found …" unless it holds."""
    if not holds:
        raise ContractBroken(f"{should}; found {found}")
