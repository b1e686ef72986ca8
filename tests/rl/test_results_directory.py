"""Finished results outlive an interrupted run; a finished run replaces them whole; a directory has one writer."""

import threading
from contextlib import suppress

import pytest

from cpgrl_opt.comparison.command import Request, compare
from cpgrl_opt.comparison.folder_lock import LOCK, FolderInUseError, locked_folder
from rl.experiments.results_directory import parts_of, results_directory

FILES = ("learning.csv", "fig.png", "summary.json")


def contents(directory):
    files = (path for path in directory.rglob("*") if path.is_file())
    return {path.relative_to(directory).as_posix(): path.read_text(encoding="utf-8") for path in files}


def run(directory, key, *, names=FILES, until=None, **options):
    """Writes the key into these files, and is interrupted after `until` of them; where it worked."""
    with suppress(KeyboardInterrupt), results_directory(directory, FILES, key, **options) as place:
        for position, name in enumerate(names):
            if position == until:
                raise KeyboardInterrupt
            (place / name).write_text(key, encoding="utf-8")
    return place


def test_interrupted_runs_leave_the_finished_one_and_each_keeps_its_own_beside_it(tmp_path):
    run(tmp_path / "a", "old")
    run(tmp_path / "a", "new", until=1)
    place = run(tmp_path / "a", "newer", until=1, parts=3)
    old, mine = dict.fromkeys(FILES, "old"), {"unfinished-new-1/learning.csv": "new"}
    assert contents(tmp_path / "a") == {**old, **mine, "unfinished-newer-3/learning.csv": "newer"}
    assert place == run(tmp_path / "a", "newer", until=0, parts=2), "it goes on where it was"
    assert parts_of(place) == 3
    run(tmp_path / "a", "newer", until=0, anew=True)
    assert contents(tmp_path / "a") == {**old, **mine}, "a run that wrote nothing leaves no folder"


def test_a_finished_run_replaces_the_earlier_one_whole_and_nothing_else(tmp_path):
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    run(tmp_path, "old")
    run(tmp_path, "new", names=("learning.csv", "summary.json"))
    assert contents(tmp_path) == {"learning.csv": "new", "summary.json": "new", "notes.txt": "mine"}
    assert {path.name for path in tmp_path.iterdir()} == {"learning.csv", "summary.json", "notes.txt"}


def test_killed_while_files_change_places_the_directory_does_not_pass_for_finished(tmp_path, monkeypatch):
    run(tmp_path, "old")

    def killed(*_):
        raise SystemExit

    monkeypatch.setattr("os.replace", killed)
    with pytest.raises(SystemExit):
        run(tmp_path, "new")
    found = contents(tmp_path)
    assert "summary.json" not in found
    assert found["unfinished-new-1/summary.json"] == "new"


def test_two_never_write_into_one_directory(tmp_path):
    refused = []

    def enter():
        with pytest.raises(FolderInUseError), results_directory(tmp_path, FILES, "key"):
            pass
        with pytest.raises(FolderInUseError):
            compare(Request(quick=True, solvers=["active-set"]), tmp_path)
        refused.append(True)

    with locked_folder(tmp_path):
        thread = threading.Thread(target=enter)
        thread.start()
        thread.join()
        assert {path.name for path in tmp_path.iterdir()} == {LOCK}
    assert refused == [True]
