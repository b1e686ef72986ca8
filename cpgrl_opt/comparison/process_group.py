"""A process and all that it starts: they end together, at the latest when the process that started them ends.

The process leads a group of its own. A second, tiny one in the same group, the guard, reads from a pipe that only the
parent can write to. Whatever ends the parent, SIGKILL too, closes the pipe, and the guard kills the group. So neither a
loop in C that never lets go of Python's lock nor a fork that outlives the process stays behind. Only what a process
moved to another group on purpose (`setsid`) escapes. On Windows, which has no groups, the process alone is ended.
"""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from subprocess import DEVNULL, PIPE, Popen
from types import FrameType
from typing import Any

_HAS_GROUPS = os.name == "posix"
_END = "os.killpg" if _HAS_GROUPS else "os.kill"
_TERMINATIONS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
# It outlives the signals that ask its parent to end: only the parent's end matters.
_GUARD = f"""
import os, signal, sys
for name in ("SIGINT", "SIGTERM", "SIGHUP"):
    if hasattr(signal, name):
        signal.signal(getattr(signal, name), signal.SIG_IGN)
sys.stdin.buffer.read()
{_END}(int(sys.argv[1]), 9)
"""


class ProcessGroup:
    """A started process, `process`, that leads a group of its own, and the end of that group.

    Parameters
    ----------
    command
        Program and arguments.
    settings
        Whatever else `subprocess.Popen` takes. `stdin` should not be the terminal, which stops a group in the
        background that reads from it. A process that reads its first order from a pipe also ends if the parent is
        killed in the moment before the guard is there.
    """

    def __init__(self, command: Sequence[str], **settings: Any) -> None:
        self.process: Popen[bytes] = Popen(command, **_grouped(0), **settings)
        self._lock = threading.Lock()
        self._is_over = False
        guard = [sys.executable, "-I", "-S", "-c", _GUARD, str(self.process.pid)]
        try:
            self._guard = Popen(guard, stdin=PIPE, stdout=DEVNULL, stderr=DEVNULL, **_grouped(self.process.pid))
        except BaseException:
            self.process.kill()
            self.process.wait()
            raise

    def kill(self) -> None:
        """End the process and all others of its group, from any thread; harmless once they are gone.

        `process.returncode` is then known: what the process ended with before, or −9.
        """
        with self._lock:
            if self._is_over:
                return
            # Until the guard is waited for, the system gives the group's number to nobody else.
            if _HAS_GROUPS:
                with contextlib.suppress(ProcessLookupError, PermissionError):  # macOS: only zombies are left
                    os.killpg(self.process.pid, signal.SIGKILL)
            self.process.kill()
            self.process.wait()
            with self._guard:  # which closes its pipe, and waits for it
                self._guard.kill()
            self._is_over = True


@contextlib.contextmanager
def exit_on_termination() -> Iterator[None]:
    """SIGTERM and SIGHUP raise SystemExit(128 + number) inside, so that `with` and `finally` clean up.

    A handler that somebody else has set stays, and so do all in any thread but the main one, where Python forbids it.
    """
    is_main = threading.current_thread() is threading.main_thread()
    changed = [number for number in _TERMINATIONS if is_main and signal.getsignal(number) == signal.SIG_DFL]
    for number in changed:
        signal.signal(number, _exit)
    try:
        yield
    finally:
        for number in changed:
            signal.signal(number, signal.SIG_DFL)


def _exit(number: int, _: FrameType | None) -> None:
    for each in _TERMINATIONS:  # a second signal does not interrupt the cleaning up
        signal.signal(each, signal.SIG_IGN)
    raise SystemExit(128 + number)


def _grouped(leader: int) -> dict[str, Any]:
    return {"process_group": leader} if _HAS_GROUPS else {}
