"""How a command ends: with which exit status, and with one line where a traceback would help nobody."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

from cpgrl_opt import MissingPackageError

from .standard_output import WRONG_USE, say

FAILED, INTERRUPTED = 1, 130
TERMINATED = (129, 143)  # SIGHUP, SIGTERM, as `exit_on_termination` raises them


def refuse(message: str) -> NoReturn:
    """Ends the command, which was used in a wrong way."""
    say(f"cpgrl: {message}", err=True)
    sys.exit(WRONG_USE)


@contextmanager
def in_one_line(*refusals: type[Exception]) -> Iterator[None]:
    """Refuses whatever the user can put right: full memory and disks, missing packages, and these refusals.

    Any ValueError is a refusal only where nothing but input is looked at: elsewhere it would be a bug of ours.
    """
    told: tuple[type[Exception], ...] = (MissingPackageError, OSError, *refusals)
    try:
        yield
    except BrokenPipeError:  # of standard output, which the entry point looks for
        raise
    except MemoryError as error:
        refuse(f"this needs more memory than there is; fewer runs or shorter episodes need less ({error})")
    except told as error:
        refuse(str(error))


@contextmanager
def telling_of_ctrl_c() -> Iterator[None]:
    """One line after Ctrl-C, where nothing is kept that could be told of."""
    try:
        yield
    except KeyboardInterrupt:
        say("Interrupted.", err=True)
        sys.exit(INTERRUPTED)


@contextmanager
def telling_what_is_kept(kept: Callable[[], str]) -> Iterator[None]:
    """After Ctrl-C, SIGTERM and SIGHUP one line, and an exit with 128 + the signal's number."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit) as end:
        code = INTERRUPTED if isinstance(end, KeyboardInterrupt) else end.code
        if code not in (INTERRUPTED, *TERMINATED):
            raise
        say(f"Interrupted. {kept()}".rstrip(), err=True)
        sys.exit(code)
