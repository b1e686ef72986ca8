"""One process at a time writes into a folder; what is killed leaves no lock; nothing is left behind."""

import errno
import os
import socket
import subprocess
import sys
import threading

import pytest

from cpgrl_opt.comparison.folder_lock import LOCK, FolderInUseError, locked_folder

HOLDER = """
import sys
from pathlib import Path
from cpgrl_opt.comparison.folder_lock import locked_folder
with locked_folder(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path):
    """A process that holds `tmp_path / "out"`."""
    command = [sys.executable, "-c", HOLDER, str(tmp_path / "out")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_the_second_is_told_who_holds_the_folder(holder, tmp_path):
    with pytest.raises(FolderInUseError) as refused, locked_folder(tmp_path / "out"):
        pass
    out, told = tmp_path / "out", str(refused.value)
    where = f"process {holder.pid} on {socket.gethostname()} since 20"
    assert told.startswith(f"{out} is being written to by '-c {out}', {where}")


@pytest.mark.parametrize("end", ["kill", "communicate"])
def test_a_folder_is_free_once_its_holder_has_ended_and_holds_nothing_of_it(end, holder, tmp_path):
    getattr(holder, end)()
    holder.wait(60)
    assert (tmp_path / "out" / LOCK).exists() == (end == "kill")
    with locked_folder(tmp_path / "out"):
        assert (tmp_path / "out" / LOCK).exists()
    assert list((tmp_path / "out").iterdir()) == []


def test_the_thread_that_holds_it_may_enter_again_and_no_other(tmp_path):
    out, refused = tmp_path / "above" / "out", []

    def enter():
        with pytest.raises(FolderInUseError, match=f"process {os.getpid()} on"), locked_folder(out):
            pass
        refused.append(True)

    with locked_folder(out):
        with locked_folder(out / ".." / "out"):
            pass
        thread = threading.Thread(target=enter)
        thread.start()
        thread.join()
    assert refused == [True]
    assert list(out.iterdir()) == []


CONTEST = """
import os, sys
from pathlib import Path
from cpgrl_opt.comparison.folder_lock import FolderInUseError, locked_folder
folder, entered = Path(sys.argv[1]), 0
while entered < 100:
    try:
        with locked_folder(folder):
            os.close(os.open(folder / "mine", os.O_CREAT | os.O_EXCL))  # fails if anybody else is in here
            entered += 1
            os.unlink(folder / "mine")
    except FolderInUseError:
        pass
"""


def test_of_many_who_try_at_once_one_is_let_in(tmp_path):
    """Each removes the lock's file as it leaves, while others have opened it already."""
    command = [sys.executable, "-c", CONTEST, str(tmp_path)]
    contestants = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(3)]
    errors = [process.communicate(timeout=120)[1] for process in contestants]
    assert [process.returncode for process in contestants] == [0, 0, 0], errors
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name == "nt", reason="has no fcntl")
def test_a_file_system_without_locks_is_said_aloud(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", refuse)
    with pytest.warns(UserWarning, match=r"is not locked \(No locks available\)"), locked_folder(tmp_path / "out"):
        pass
    assert list((tmp_path / "out").iterdir()) == []
