"""Parent of one process: when that process or the caller ends, all that the process started ends.

    python -I -S _supervisor.py LIFELINE PROGRAM ARGUMENT...

`ProcessGroup` runs it. LIFELINE is the end to read of a pipe that only the caller can write to: whatever ends the
caller, SIGKILL too, closes it. On Linux the supervisor adopts every orphan below it, those that left the group by
`setsid` too, and the process dies with its supervisor. Elsewhere only the process group ends.
"""

import ctypes
import os
import signal
import sys
import threading
from contextlib import suppress
from pathlib import Path

# <linux/prctl.h>
_DIE_WITH_PARENT, _ADOPT_ORPHANS = 1, 36
_DEAF_TO = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # only the ends of process and caller matter
_IGNORED_BY_PYTHON = (signal.SIGPIPE, signal.SIGXFSZ)


def main(lifeline: int, command: list[str]) -> None:
    """Starts the command and ends as it does."""
    prctl = getattr(ctypes.CDLL(None), "prctl", lambda *_: None)
    for number in _DEAF_TO:
        signal.signal(number, signal.SIG_IGN)
    prctl(_ADOPT_ORPHANS, 1, 0, 0, 0)
    process = os.fork()
    if process == 0:
        for number in (*_DEAF_TO, *_IGNORED_BY_PYTHON):  # a program inherits what is ignored
            signal.signal(number, signal.SIG_DFL)
        os.setsid()
        os.close(lifeline)
        prctl(_DIE_WITH_PARENT, signal.SIGKILL, 0, 0, 0)
        os.execvp(command[0], command)
    nothing = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):  # the process's pipes
        os.dup2(nothing, descriptor)
    threading.Thread(target=_end_with_caller, args=(lifeline, process), daemon=True).start()
    ended, status = os.wait()
    while ended != process:
        ended, status = os.wait()
    _end_descendants(process)
    _end_by(status)


def _end_with_caller(lifeline: int, process: int) -> None:
    os.read(lifeline, 1)
    with suppress(OSError):
        os.kill(process, signal.SIGKILL)


def _end_descendants(group: int) -> None:
    """Kills generation after generation: the children of whatever was killed become the supervisor's."""
    with suppress(OSError):
        os.killpg(group, signal.SIGKILL)
    with suppress(ChildProcessError):  # none is left
        while True:
            children = _children()
            for child in children:
                with suppress(OSError):
                    os.kill(child, signal.SIGKILL)
            if os.waitpid(-1, 0 if children else os.WNOHANG) == (0, 0):
                return  # a system that does not list them


def _children() -> list[int]:
    """From /proc/PID/stat: "PID (NAME) STATE PARENT ...", where the name may hold anything."""
    found, own = [], str(os.getpid())
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, IndexError):
            if (folder / "stat").read_text(errors="replace").rpartition(")")[2].split()[1] == own:
                found.append(int(folder.name))
    return found


def _end_by(status: int) -> None:
    code = os.waitstatus_to_exitcode(status)
    if code < 0:
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if -code not in (signal.SIGKILL, signal.SIGSTOP):
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(code)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
