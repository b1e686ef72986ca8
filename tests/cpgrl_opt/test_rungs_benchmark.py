"""The table of rungs: every problem is counted once, and the ladder says what the rows say."""

import csv
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
FAMILIES = ("well-conditioned", "opposing-1e-6", "opposing-1e-12", "infeasible", "sum-to-zero-equality")


def test_each_rung_is_met_and_agrees_with_the_rows(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "benchmarks/rungs.py",
        "--problems",
        "3",
        "--out",
        str(tmp_path),
        "--families",
        *FAMILIES,
    ]
    printed = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    with (tmp_path / "rungs.csv").open(encoding="utf-8") as file:
        rows = {row["family"]: row for row in csv.DictReader(file)}
    assert tuple(rows) == FAMILIES
    assert [rows[name]["gramian"] for name in FAMILIES] == ["3", "0", "0", "0", "0"]
    assert [rows[name]["pairs"] for name in FAMILIES] == ["0", "3", "0", "3", "3"]
    assert rows["opposing-1e-12"]["rows"] == "3"
    for name, row in rows.items():
        assert int(row["other_status"]) == 0, name
        assert float(row["apart"]) <= 1e-12, name
    assert "| well-conditioned | 3 | 3 | 0 | 0 | 0 |" in printed
    assert (tmp_path / "rungs.md").read_text(encoding="utf-8").strip() == printed.strip()
