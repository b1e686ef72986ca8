"""One process at a time writes into a folder; another is told who does.

The lock is the system's own on a file in the folder (`flock`, on Windows a locked byte), so that it ends with the
process that holds it, however that ends: a file left behind by SIGKILL locks nothing. Over NFS and SMB the system asks
the server, so that other machines see the lock too; a machine that goes down holds it until the server forgets it (a
minute or two). Where the file system has no locks, a warning says so and nothing is locked.
"""

import contextlib
import errno
import json
import os
import shlex
import socket
import sys
import threading
import warnings
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

LOCK = ".cpgrl-lock"
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)
_FAR = 1 << 30  # the byte to lock on Windows, far beyond the holder's text: there nobody can read a locked byte
_held: dict[Path, int] = {}  # folder → the thread that holds it


class FolderInUseError(OSError):
    """Another process, or another thread of this one, writes into the folder; the message says who."""


@contextlib.contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Makes the folder where it is missing, and keeps all others from it until the context ends.

    Whoever holds the folder may enter again, in the same thread. Raises FolderInUseError at once where it is held, and
    OSError where there can be no such folder.
    """
    folder.mkdir(parents=True, exist_ok=True)
    key = folder.resolve()
    if _held.get(key) == threading.get_ident():
        yield
        return
    descriptor = _locked(folder)
    _held[key] = threading.get_ident()
    try:
        yield
    finally:
        del _held[key]
        _release(folder, descriptor)


def _locked(folder: Path) -> int:
    """A descriptor of the lock's file, which nobody else holds and which is the one in the folder."""
    while True:
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _lock(descriptor)
        except OSError as error:
            if error.errno in _NO_LOCKS:
                words = f"{folder} is not locked ({error.strerror}): see to it that nothing else writes into it"
                warnings.warn(words, stacklevel=5)
                return descriptor
            told = _holder(descriptor)
            os.close(descriptor)
            raise FolderInUseError(
                f"{folder} is being written to by {told}; wait for its end or take another folder"
            ) from error
        if _is_in(folder, descriptor):
            _sign(descriptor)
            return descriptor
        os.close(descriptor)  # whoever held it has just removed it


def _release(folder: Path, descriptor: int) -> None:
    """The file goes while it is still locked: whoever opened it meanwhile finds it gone, and opens another."""
    with contextlib.suppress(OSError):  # Windows keeps a file that is open
        (folder / LOCK).unlink()
    os.close(descriptor)
    if os.name == "nt":
        with contextlib.suppress(OSError):  # it is open elsewhere
            (folder / LOCK).unlink()


def _lock(descriptor: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        os.lseek(descriptor, _FAR, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _is_in(folder: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), (folder / LOCK).stat())
    except FileNotFoundError:
        return False


def _sign(descriptor: int) -> None:
    """Who holds it, for whoever comes second."""
    program = Path(sys.argv[0]).name if sys.argv else ""
    facts = {
        "command": shlex.join([program, *sys.argv[1:]]),
        "process": os.getpid(),
        "host": socket.gethostname(),
        "since": datetime.now().astimezone().isoformat(" ", "seconds"),
    }
    os.ftruncate(descriptor, 0)
    os.lseek(descriptor, 0, os.SEEK_SET)
    os.write(descriptor, json.dumps(facts).encode())


def _holder(descriptor: int) -> str:
    """Who signed; "another process" in the moment before it has."""
    os.lseek(descriptor, 0, os.SEEK_SET)
    try:
        facts = json.loads(os.read(descriptor, 1 << 16))
        return f"{facts['command']!r}, process {facts['process']} on {facts['host']} since {facts['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"
