"""Finished results outlive an interrupted run; a finished run replaces them whole."""

from contextlib import suppress

import pytest

from rl.experiments.results_directory import place_for, results_directory

FILES = ("learning.csv", "fig.png", "summary.json")


def contents(directory):
    files = (path for path in directory.rglob("*") if path.is_file())
    return {path.relative_to(directory).as_posix(): path.read_text(encoding="utf-8") for path in files}


def run(directory, text, *, names=FILES, until=None):
    """Writes these files, and is interrupted after `until` of them."""
    with suppress(KeyboardInterrupt), results_directory(directory, FILES) as place:
        for position, name in enumerate(names):
            if position == until:
                raise KeyboardInterrupt
            (place / name).write_text(text, encoding="utf-8")


def test_a_new_directory_is_written_into_at_once(tmp_path):
    run(tmp_path / "a" / "b", "1", until=1)
    assert contents(tmp_path / "a" / "b") == {"learning.csv": "1"}


def test_an_interrupted_run_leaves_the_finished_one_and_keeps_its_own_beside_it(tmp_path):
    run(tmp_path, "old")
    run(tmp_path, "new", until=1)
    run(tmp_path, "newer", until=1)
    old = dict.fromkeys(FILES, "old")
    assert contents(tmp_path) == {**old, "unfinished/learning.csv": "new", "unfinished-2/learning.csv": "newer"}


def test_a_finished_run_replaces_the_earlier_one_whole_and_nothing_else(tmp_path):
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    run(tmp_path, "old")
    run(tmp_path, "new", names=("learning.csv", "summary.json"))
    assert contents(tmp_path) == {"learning.csv": "new", "summary.json": "new", "notes.txt": "mine"}
    assert {path.name for path in tmp_path.iterdir()} == {"learning.csv", "summary.json", "notes.txt"}


def test_a_run_that_wrote_nothing_leaves_no_folder(tmp_path):
    run(tmp_path, "old")
    run(tmp_path, "new", until=0)
    assert {path.name for path in tmp_path.iterdir()} == set(FILES)


def test_killed_while_files_change_places_the_directory_does_not_pass_for_finished(tmp_path, monkeypatch):
    run(tmp_path, "old")

    def killed(*_):
        raise SystemExit

    monkeypatch.setattr("os.replace", killed)
    with pytest.raises(SystemExit):
        run(tmp_path, "new")
    found = contents(tmp_path)
    assert "summary.json" not in found
    assert found["unfinished/summary.json"] == "new"


def test_the_place_is_known_before_anything_is_written(tmp_path):
    assert place_for(tmp_path, FILES) == tmp_path
    (tmp_path / "fig.png").write_text("old", encoding="utf-8")
    assert place_for(tmp_path, FILES) == tmp_path / "unfinished"
    assert not (tmp_path / "unfinished").exists()
