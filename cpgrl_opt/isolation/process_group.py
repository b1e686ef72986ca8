"""A process and all that it starts: they end together, at the latest when the process that started them ends.

Neither a loop in C that never lets go of Python's lock, nor a fork that outlives the process, nor on Linux one that
has left the group (`setsid`) stays behind. See `_supervisor.py` for how. On Windows, which has no groups, only the
process itself is ended, and only by `kill`.
"""

import contextlib
import os
import signal
import sys
import threading
import weakref
from collections.abc import Iterator, Sequence
from pathlib import Path
from subprocess import Popen, TimeoutExpired
from types import FrameType
from typing import Any

_HAS_GROUPS = os.name == "posix"
_SUPERVISOR = str(Path(__file__).with_name("_supervisor.py"))
_GRACE = 5.0  # s: a supervisor needs a millisecond, on a loaded machine a second, and one that was stopped for ever
_TERMINATIONS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


class ProcessGroup:
    """A started process and the end of all that it starts.

    `process` has its pipes and its exit code; its number is that of the supervisor.

    Parameters
    ----------
    command
        Program and arguments.
    settings
        Whatever else `subprocess.Popen` takes.
    """

    def __init__(self, command: Sequence[str], **settings: Any) -> None:
        self._lock = threading.Lock()
        self._lifeline: int | None = None  # before a fork in another thread may ask for it
        _GROUPS.add(self)
        if not _HAS_GROUPS:
            self.process: Popen[bytes] = Popen(command, **settings)
            return
        held, self._lifeline = os.pipe()
        supervised = [sys.executable, "-I", "-S", _SUPERVISOR, str(held), *command]
        try:
            self.process = Popen(supervised, pass_fds=(held,), start_new_session=True, **settings)
        except BaseException:
            os.close(self._lifeline)
            raise
        finally:
            os.close(held)

    def kill(self) -> None:
        """End the process and all others of its group, from any thread; harmless once they are gone, or in a fork.

        `process.returncode` is then known: what the process ended with before, or −9.
        """
        with self._lock:
            if self._lifeline is not None:
                os.close(self._lifeline)
                self._lifeline = None
                with contextlib.suppress(TimeoutExpired):
                    self.process.wait(_GRACE)
            self.process.kill()
            self.process.wait()

    def disown(self) -> None:
        """Let the lifeline go in a fork of the caller's, which neither keeps the process alive nor ends it.

        `kill` there ends nothing either: `Popen` finds no child of that number.
        """
        if self._lifeline is not None:
            os.close(self._lifeline)
            self._lifeline = None


def _disown_all() -> None:
    for group in _GROUPS:
        group.disown()


_GROUPS: "weakref.WeakSet[ProcessGroup]" = weakref.WeakSet()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_disown_all)


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
