"""One process that does what it is told, and what is known of it when it hangs or ends.

Nothing here waits for a pipe that somebody else may hold: a thread that nobody joins does.
"""

import ctypes
import os
import pickle
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from signal import Signals
from time import monotonic
from typing import Any, BinaryIO

from . import _worker
from .errors import AnswerError, CrashError, HangError
from .process_group import ProcessGroup

START_LIMIT = 600.0  # s, for imports and, on a machine's first day, for compiling
_LOOK_EVERY = 0.05  # s: how late a limit is noticed
_TELLING = 0.3  # s, for the process to write where it is
_SHOWN = 4000  # the last characters of what it wrote that are looked at: a stack of frames is as long
_MOST_OUTPUT = 2**26  # bytes, 64 MiB: a loop that prints fills a disk in a minute
_READ_AT_ONCE = 2**20  # bytes: a loop writes that much in some milliseconds

Reply = tuple[str, Any]  # its kind and what it says; None where the process is gone


class Process:
    """One process, its pipes, the thread that waits for them, and the file of what it prints."""

    def __init__(self, environment: Mapping[str, str], shows_output: bool) -> None:
        self._output: BinaryIO = tempfile.TemporaryFile()  # noqa: SIM115 - `end` closes it
        self.group = ProcessGroup(
            [sys.executable, "-P", _worker.__file__, *sys.path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=None if shows_output else self._output,
            env=environment,
        )
        self._pid = 0
        self._orders: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._replies: queue.SimpleQueue[Reply | None] = queue.SimpleQueue()
        process: Any = self.group.process
        exchange = self._orders, self._replies, process.stdin, process.stdout
        self._thread = threading.Thread(target=_exchange, args=exchange, daemon=True)
        self._thread.start()

    def start(self, *orders: bytes | None) -> None:
        """Has the object made, and whatever else comes first done. Raises what these do."""
        for order in orders:
            if order is not None:
                kind, answer = self.ask(order, START_LIMIT)
                if kind == "error":
                    raise answer
                self._pid = self._pid or answer

    def ask(
        self, order: bytes, time_limit: float, cpu_limit: float = 0.0, listen: Callable[[Any], None] | None = None
    ) -> Reply:
        """("answer", what an order gave), ("error", the exception raised there), or ("unsent", why neither came).

        Raises HangError, CrashError, and AnswerError where what came cannot be read.
        """
        self._orders.put(order)
        start, used = monotonic(), cpu_seconds(self._pid) if cpu_limit else 0.0
        is_over = False
        while True:
            try:
                reply = self._replies.get(timeout=_LOOK_EVERY)
            except queue.Empty:
                if is_over:  # somebody else holds its pipe
                    raise self._crash() from None
                is_over = self.group.process.poll() is not None
            else:
                if reply is None:
                    raise self._crash()
                kind, content = reply
                if kind == "unread":
                    raise AnswerError(f"an answer that can be unpickled should come back; found {content}")
                if kind != "report":
                    return reply
                if listen is not None:
                    listen(content)
            if monotonic() - start > time_limit:
                raise HangError(f"no answer within {time_limit:g} s{self._place()}")
            if cpu_limit and cpu_seconds(self._pid) - used > cpu_limit:
                raise HangError(f"no answer within {cpu_limit:g} s of processor time{self._place()}")
            if os.fstat(self._output.fileno()).st_size > _MOST_OUTPUT:
                os.ftruncate(self._output.fileno(), 0)  # who writes goes on where he was: a file with a hole

    def end(self) -> None:
        """Ends the process and whatever it started."""
        self.group.kill()
        self._orders.put(None)
        self._thread.join(1.0)
        if not self._thread.is_alive():  # else somebody who cannot be killed holds a pipe
            for stream in (self.group.process.stdin, self.group.process.stdout):
                with suppress(OSError):
                    stream.close()  # type: ignore[union-attr]
        self._output.close()

    def _crash(self) -> CrashError:
        return CrashError(f"the end of the process ({self._end_in_words()}){self._last_words()}")

    def _end_in_words(self) -> str:
        with suppress(subprocess.TimeoutExpired):
            self.group.process.wait(1.0)
        code = self.group.process.returncode
        if code is None or code >= 0:
            return f"exit code {code}"
        with suppress(ValueError):
            return f"signal {Signals(-code).name}"
        return f"signal {-code}"

    def _place(self) -> str:
        """Where it hangs: the frames that it writes on a signal, innermost first; nothing where it is stopped."""
        before = os.fstat(self._output.fileno()).st_size
        if _worker.WHERE is None or not self._pid:
            return ""
        with suppress(OSError):
            os.kill(self._pid, _worker.WHERE)
        text, end = "", monotonic() + _TELLING
        while monotonic() < end:
            time.sleep(0.01)
            size = min(os.fstat(self._output.fileno()).st_size, before + _READ_AT_ONCE)
            is_told = bool(_frames(text))  # by the turn before: now the last of them are there too
            # What it prints comes before and in between: unless the frames are in it, its end alone is kept.
            text, before = (text if is_told else text[-_SHOWN:]) + self._read(before, size), size
            if is_told:
                break
        return _frames(text)

    def _last_words(self) -> str:
        size = os.fstat(self._output.fileno()).st_size
        text = self._read(max(0, size - _SHOWN), size)
        if frames := _frames(text):  # of a crash in C
            return frames
        return f"; it last wrote: {' '.join(text[-_SHOWN // 4 :].split())}" if text.strip() else ""

    def _read(self, start: int, end: int) -> str:
        if not hasattr(os, "pread"):  # Windows; to seek would move the place where the process writes
            return ""
        return os.pread(self._output.fileno(), end - start, start).decode(errors="replace").strip("\0")


def _exchange(
    orders: "queue.SimpleQueue[bytes | None]",
    replies: "queue.SimpleQueue[Reply | None]",
    stdin: BinaryIO,
    stdout: BinaryIO,
) -> None:
    """Sends each order and waits for its reply, until the other side is gone."""
    try:
        while (order := orders.get()) is not None:
            pickle.dump(order, stdin)
            stdin.flush()
            kind = "report"
            while kind == "report":
                kind, content = pickle.load(stdout)
                replies.put(_unpack(kind, content))
    except Exception:  # an end in the middle of a message has many names
        replies.put(None)


def _unpack(kind: str, content: bytes) -> Reply:
    try:
        return kind, pickle.loads(content)
    except BaseException as error:  # of a class that cannot be imported here, or whatever its `__reduce__` calls
        return "unread", f"{type(error).__name__}: {error}"


def _frames(text: str) -> str:
    """The innermost frames of the stack that faulthandler wrote, but for those of `_worker`; "" for none."""
    lines = [line.strip() for line in text.splitlines() if line.startswith("  File ")]
    frames = [line for line in lines if _worker.__file__ not in line]
    return f"; it was at {', in '.join(frames[:3])}" if frames else ""


def cpu_seconds(pid: int) -> float:
    """CPU time that a process has used so far; 0 where the system does not tell (then only the wall clock counts)."""
    clock = ctypes.c_int()
    find: Any = getattr(_worker.c_library(), "clock_getcpuclockid", None)
    if find is None or find(pid, ctypes.byref(clock)) != 0:
        return 0.0
    try:
        return time.clock_gettime(clock.value)
    except OSError:  # it is gone
        return 0.0
