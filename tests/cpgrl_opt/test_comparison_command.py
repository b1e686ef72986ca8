"""The body of `cpgrl compare`: what it writes, what it says, how it refuses."""

import csv
import shlex
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from cpgrl_opt import MissingPackageError
from cpgrl_opt.comparison.command import QUICK_FAMILIES, Request, compare, run_command
from cpgrl_opt.comparison.families import FAMILIES
from cpgrl_opt.comparison.measurement import read_measurements
from cpgrl_opt.comparison.table import as_table, count

from .comparisons import finish, measurement

TINY = Request(solvers=["active-set", "nnls", "scs"], families=["zero-rows*"], problems=2)


def test_it_writes_the_files_says_what_is_missing_and_does_nothing_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("cpgrl_opt.solvers.packages.has_package", lambda package: package != "scs")
    said: list[str] = []
    run_command(TINY, tmp_path, jobs=1, anew=False, say=said.append)
    assert said[0].startswith("scs is not installed")
    assert said[1].startswith("Wrote measurements.csv, solvers.csv, report.md, report.html into")
    assert "active-set" in capsys.readouterr().out
    with (tmp_path / "solvers.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0][:3] == ["solver", "variant", "family"]
    assert [row[0] for row in rows[1:]] == ["active-set", "nnls", "nnls"] * 2
    assert "| scs | not installed |" in (tmp_path / "report.md").read_text()
    measurements = read_measurements(tmp_path / "measurements.csv")
    assert all(each.outcome == "success" for each in measurements if each.variant == "prepared")

    monkeypatch.setattr("cpgrl_opt.isolation.process_group.Popen", None)  # no worker is needed
    assert compare(TINY, tmp_path).measurements == measurements


def test_a_package_that_cannot_be_imported_is_no_crash_of_its_solver(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "scs.py").write_text("raise ImportError('libgomp.so.1: cannot open')", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "scs", raising=False)
    with pytest.raises(MissingPackageError) as refused:
        compare(replace(TINY, solvers=["scs"]), tmp_path / "out")
    assert str(refused.value).endswith("which is installed but cannot be imported: libgomp.so.1: cannot open")


def test_a_part_is_reported_alone_and_drops_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = replace(TINY, solvers=["active-set"])
    settings, _ = whole.settings()
    done = finish(settings, tmp_path, {})
    monkeypatch.setattr("cpgrl_opt.isolation.process_group.Popen", None)  # no worker is needed
    said: list[str] = []
    run_command(replace(whole, families=["zero-rows"]), tmp_path, jobs=1, anew=False, say=said.append)
    assert said[-1] == "measurements.csv keeps what was finished before and not asked for now, unreported: cells: 1."
    assert "zero-rows-equality" not in (tmp_path / "report.md").read_text()
    with (tmp_path / "solvers.csv").open() as file:
        assert [row["family"] for row in csv.DictReader(file)] == ["zero-rows"]
    monkeypatch.setattr("cpgrl_opt.comparison.runner.monotonic", iter(range(0, 1000, 100)).__next__)
    assert compare(whole, tmp_path).measurements == done
    assert '"wall_seconds": 0.0' in (tmp_path / "settings.json").read_text(), "nothing was measured"


def test_quick_is_a_part_of_the_whole() -> None:
    assert Request().folder() == Path("cpgrl-output/compare")
    assert Request(quick=True).folder() == Path("cpgrl-output/compare-quick")
    quick, _ = Request(quick=True, solvers=["active-set"]).settings()
    whole, _ = Request(solvers=["active-set"]).settings()
    assert set(quick.families) == set(QUICK_FAMILIES) < set(whole.families) == set(FAMILIES)
    assert (quick.problems, whole.problems) == (3, 20)
    odd = Request(families=["zero-rows*", "a `b`.npz"])
    assert shlex.split(odd.command()) == ["cpgrl", "compare", "--families", "zero-rows*,a `b`.npz", "--seed", "0"]
    assert Request(quick=True, solvers=["osqp"], problems=4).command() == (
        "cpgrl compare --solvers osqp --problems 4 --quick --seed 0"
    )


def test_large_families_are_tried_on_fewer_problems_and_not_raw() -> None:
    settings, _ = Request(solvers=["nnls"], problems=10).settings()
    cells = settings.cells()
    assert cells["nnls", "prepared", "well-conditioned-1000x5"] == 2
    assert ("nnls", "raw", "well-conditioned-1000x5") not in cells
    assert cells["nnls", "raw", "well-conditioned"] == 10


def test_a_summary_leaves_out_what_a_solver_does_not_take() -> None:
    solved = measurement(solver="rosen", ratio=2.0)
    wrong = replace(solved, family="duplicate", outcome="silently-wrong", ratio=4.0, seconds=2e-5)
    other = replace(solved, family="infeasible", outcome="unsupported", ratio=0.0, seconds=0.0)
    # (2 · 2 · 5 s / 5 µs)^(1/3) is what 5 s for the wrong one make of it.
    found = count(as_table([solved, replace(solved, problem=1), wrong, other]), ["solver"]).loc["rosen"]
    assert (found["taken"], found["success"], found["silently-wrong"]) == (3, 2, 1)
    assert found["time"] == pytest.approx(159, abs=0.5)
