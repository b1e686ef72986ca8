"""Rows are on disk as they come and in order at the end."""

from contextlib import suppress

import pytest

from rl.experiments.tidy_csv import TidyCsv

COLUMNS = ["method", "run", "episode", "value"]


def test_rows_are_on_disk_before_the_file_is_closed(tmp_path):
    path = tmp_path / "learning.csv"
    with TidyCsv(path, COLUMNS, ["a"]) as table:
        assert path.read_text(encoding="utf-8") == "method,run,episode,value\n"
        table.append([("a", 0, 0, 0.5)])
        assert path.read_text(encoding="utf-8") == "method,run,episode,value\na,0,0,0.5\n"


def test_an_exception_leaves_what_was_appended_in_order(tmp_path):
    path = tmp_path / "learning.csv"
    with suppress(KeyboardInterrupt), TidyCsv(path, COLUMNS, ["b", "a"]) as table:
        table.append([("a", 10, 0, 1.0), ("a", 2, 100, 2.0)])
        table.append([("a", 2, 20, 3.0), ("b", 0, 0, 4.0)])
        raise KeyboardInterrupt
    assert path.read_text(encoding="utf-8").splitlines()[1:] == ["b,0,0,4", "a,2,20,3", "a,2,100,2", "a,10,0,1"]
    assert [each.name for each in tmp_path.iterdir()] == ["learning.csv"]


def test_appending_to_a_closed_file_is_refused(tmp_path):
    table = TidyCsv(tmp_path / "learning.csv", COLUMNS, ["a"])
    with pytest.raises(ValueError, match="closed"):
        table.append([("a", 0, 0, 1.0)])


def test_numbers_keep_nine_digits(tmp_path):
    with TidyCsv(tmp_path / "x.csv", COLUMNS, ["a"]) as table:
        table.append([("a", 0, 0, 1 / 3), ("a", 0, 1, 1e-12), ("a", 0, 2, 7)])
    values = [row.split(",")[-1] for row in (tmp_path / "x.csv").read_text(encoding="utf-8").splitlines()[1:]]
    assert values == ["0.333333333", "1e-12", "7"]
