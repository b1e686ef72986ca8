"""One process at a time writes into a folder; another is told who does.

The lock is the system's own on a file in the folder (see `filelock`), so that it ends with the process that holds it,
however that ends: a file left behind by SIGKILL locks nothing. Over NFS and SMB the system asks the server, so that
other machines see the lock too; a machine that goes down holds it until the server forgets it (a minute or two). Where
the file system has no locks, a warning says so and nothing is locked.
"""

import contextlib
import errno
import os
import shlex
import socket
import sys
import warnings
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

LOCK = ".cpgrl-lock"
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)


class FolderInUseError(OSError):
    """Another process, or another thread of this one, writes into the folder; the message says who."""


@contextlib.contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Makes the folder where it is missing, and keeps all others from it until the context ends.

    Whoever holds the folder may enter again, in the same thread. Raises FolderInUseError at once where it is held, and
    OSError where there can be no such folder.
    """
    from filelock import FileLock, Timeout  # 40 ms that only commands need

    folder.mkdir(parents=True, exist_ok=True)
    file = folder.resolve() / LOCK
    lock = FileLock(file, timeout=0, is_singleton=True, fallback_to_soft=False)
    try:
        lock.acquire()
    except Timeout:
        raise FolderInUseError(
            f"{folder} is being written to by {_holder(file)}; wait for its end or take another folder"
        ) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        words = f"{folder} is not locked ({error.strerror}): see to it that nothing else writes into it"
        warnings.warn(words, stacklevel=3)
    is_within = lock.lock_counter > 1
    try:
        if not is_within:
            file.write_text(_signature(), encoding="utf-8")
        yield
    finally:
        if not is_within:
            # While it is still locked: whoever opened it meanwhile finds it gone, and opens another.
            with contextlib.suppress(OSError):  # Windows keeps a file that is open
                file.unlink()
        lock.release()


def _signature() -> str:
    """Who holds it, for whoever comes second."""
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]) if sys.argv else ""
    since = datetime.now().astimezone().isoformat(" ", "seconds")
    return f"{command!r}, process {os.getpid()} on {socket.gethostname()} since {since}"


def _holder(file: Path) -> str:
    """Who signed; "another process" in the moment before it has, and on Windows, where nobody reads a locked file."""
    with contextlib.suppress(OSError, UnicodeError):
        return file.read_text(encoding="utf-8") or "another process"
    return "another process"
