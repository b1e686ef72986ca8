"""The process that `Isolated` talks to: gets an object, then calls functions with it, until its caller is gone.

    python -P _worker.py ENTRY_OF_SYS_PATH...

A file to be run, so that the process imports nothing but what it is sent.

Orders come through what was descriptor 0, and replies go through what was 1. Descriptors 1 and 2 lead into a file that
the caller made, so that what a library prints, from C too, meets nobody and can be looked at.
"""

import contextlib
import ctypes
import faulthandler
import os
import pickle
import signal
import sys
import traceback
from collections.abc import Callable
from functools import partial
from typing import Any, BinaryIO

# A signal that nothing else uses: the caller sends it at the limit, to read where the code is.
WHERE = getattr(signal, "SIGUSR1", None)
_MAIN = b"__main__"


def serve() -> None:
    """The main function of the process."""
    incoming, outgoing = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    faulthandler.enable()
    if WHERE is not None:
        faulthandler.register(WHERE)
    with contextlib.suppress(EOFError, OSError):
        subject = None
        send = partial(_send, outgoing, os.getpid())
        while True:
            order = pickle.load(incoming)
            subject, kind, content = _carry_out(order, subject, lambda message: send("report", pack(message)))
            send(kind, content)


def _send(outgoing: BinaryIO, owner: int, kind: str, content: bytes) -> None:
    if os.getpid() != owner:  # a fork of the called code's, which would answer in its parent's name
        os._exit(0)
    pickle.dump((kind, content), outgoing)
    outgoing.flush()


def _carry_out(order: bytes, subject: Any, report: Callable[[Any], None]) -> tuple[Any, str, bytes]:
    """The object afterwards, the kind of reply ("answer", "error", "unsent") and what it says, pickled."""
    answer: Any
    try:
        function, arguments, reports = pickle.loads(order)
        arguments = (*arguments, report) if reports else arguments
        if function == "start":
            subject, answer = _start(*arguments), os.getpid()
        elif function == "attribute":
            found = getattr(subject, *arguments)
            answer = (True, None) if callable(found) else (False, found)
        elif isinstance(function, str):
            answer = getattr(subject, function.removeprefix("."))(*arguments)
        else:
            answer = function(subject, *arguments)
    except Exception as error:  # handed over, raised there
        return subject, "error", pack(portable(error))
    try:
        return subject, "answer", pack(answer)
    except MemoryError as error:
        return subject, "error", pack(portable(error))
    except (Exception, SystemExit) as error:  # of its `__reduce__`, say
        return subject, "unsent", pack(f"{type(answer).__name__}, {type(error).__name__}: {error}")


def _start(memory_limit: int | None, make: bytes) -> Any:
    if memory_limit is not None:
        _limit_memory(memory_limit)
    return pickle.loads(make)()


def pack(value: Any) -> bytes:
    """The value pickled, with its class where that is of the caller's `__main__`: here another module has that name."""
    try:
        packed = pickle.dumps(value)
    except MemoryError:
        raise
    except Exception:
        packed = _MAIN
    if _MAIN in packed:
        import cloudpickle

        packed = cloudpickle.dumps(value)
    return packed


def portable(error: Exception) -> Exception:
    """The exception with its traceback as a note; as a RuntimeError if it does not survive pickling."""
    try:
        again: Exception = pickle.loads(pack(error))
    except Exception:  # an __init__ of other arguments than args
        again = RuntimeError(f"{type(error).__name__}: {error}")
    again.add_note("in another process:\n" + "".join(traceback.format_exception(error)))
    return again


def output_size() -> int:
    """How many bytes this process has written to its standard output and error so far."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    with contextlib.suppress(AttributeError):
        c_library().fflush(None)  # all of C's streams
    return os.fstat(2).st_size


def c_library() -> Any:
    """The C library that Python itself uses."""
    if os.name == "nt":
        return getattr(ctypes, "cdll").msvcrt  # noqa: B009 - absent elsewhere
    return ctypes.CDLL(None)


def _limit_memory(limit: int) -> None:
    """Of what the process allocates, on systems that know such a limit; more is a MemoryError."""
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


if __name__ == "__main__":
    sys.path[:] = sys.argv[1:]
    serve()
