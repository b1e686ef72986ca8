"""Standard output that takes any text, and that may be full, closed or read by nobody."""

import contextlib
import io
import os
import sys
from collections.abc import Iterator

WRONG_USE = 2
NOBODY_READS = 141  # 128 + SIGPIPE: what a shell says of a program that this signal ended


@contextlib.contextmanager
def standard_output() -> Iterator[None]:
    """Lets a command print whatever its terminal, pipe or file takes; for the entry point of a process only.

    A character that the encoding lacks (λ in cp1252) is printed as a question mark, so that no verdict is lost for it.
    What the command printed is written when the context ends. Where that is impossible the process exits: with
    NOBODY_READS if the reader left, as `head` does, and with WRONG_USE and one line on stderr if the disk is full.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the caller: `>&-`
            setattr(sys, name, io.StringIO())
    for stream in (sys.stdout, sys.stderr):
        # The C locale's surrogateescape writes names of files as they are, but refuses λ as strict does.
        if isinstance(stream, io.TextIOWrapper) and stream.errors in ("strict", "surrogateescape"):
            stream.reconfigure(errors="replace")
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        _discard_output()
        sys.exit(NOBODY_READS)
    except OSError as error:
        _discard_output()
        say(f"cpgrl: {error}", err=True)
        sys.exit(WRONG_USE)


def say(text: str, *, err: bool = False) -> None:
    """Prints a line; unlike typer's echo, in the encoding of the stream even where that is ASCII."""
    stream = sys.stderr if err else sys.stdout
    try:
        stream.write(f"{text}\n")
        stream.flush()
    except BrokenPipeError:  # typer would make it 1, which is a verdict here
        if not err:
            _discard_output()
        sys.exit(NOBODY_READS)


def _discard_output() -> None:
    """Leads standard output nowhere: Python writes what is left when it exits, and would fail again."""
    with contextlib.suppress(OSError, ValueError):
        target = os.open(os.devnull, os.O_WRONLY)
        os.dup2(target, sys.stdout.fileno())
        os.close(target)
