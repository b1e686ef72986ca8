"""Rows are on disk as they come and in order at the end."""

from contextlib import suppress

import pytest

from rl.experiments.tidy_csv import TidyCsv

COLUMNS = ["method", "run", "episode", "value"]


def test_rows_are_on_disk_as_they_come_and_in_order_whatever_ends_it(tmp_path):
    path = tmp_path / "learning.csv"
    table = TidyCsv(path, COLUMNS, ["b", "a"])
    with pytest.raises(ValueError, match="closed"):
        table.append([("a", 0, 0, 1.0)])
    with suppress(KeyboardInterrupt), table:
        assert path.read_text(encoding="utf-8") == "method,run,episode,value\n"
        table.append([("a", 10, 0, 1 / 3), ("a", 2, 100, 1e-12)])
        assert path.read_text(encoding="utf-8").endswith("value\na,10,0,0.333333333\na,2,100,1e-12\n")
        table.append([("a", 2, 20, 3.0), ("b", 0, 0, 7)])
        raise KeyboardInterrupt
    assert path.read_text(encoding="utf-8").splitlines()[1:] == [
        "b,0,0,7", "a,2,20,3", "a,2,100,1e-12", "a,10,0,0.333333333"
    ]  # fmt: skip
    assert [each.name for each in tmp_path.iterdir()] == ["learning.csv"]
