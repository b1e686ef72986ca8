"""A cell of the comparison is as good as what it was measured on: what has changed is measured anew, and only that."""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from cpgrl_opt.comparison import cell_keys as keys_module
from cpgrl_opt.comparison import machine
from cpgrl_opt.comparison.cell_keys import cell_keys, settings_of
from cpgrl_opt.comparison.command import Request, run_command
from cpgrl_opt.comparison.measurement import read_measurements
from cpgrl_opt.comparison.runner import ComparisonSettings, open_checkpoint, run_comparison
from cpgrl_opt.comparison.sources import sources_of

from .comparisons import BenchHere, finish

WRONG = """
from cpgrl_opt import SOLVERS

class Mine:
    def solve(self, problem):
        answer = SOLVERS["active-set"].solve(problem)
        answer.value[:] += 1.0
        return answer

S = Mine()
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current one, from which modules are imported, each test's under a name of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def test_a_mended_solver_is_measured_anew_and_the_others_are_kept(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cpgrl_opt.comparison.runner.isolated_bench", BenchHere)
    (folder / "mended.py").write_text(WRONG, encoding="utf-8")
    request = Request(solvers=["active-set", "mended:S"], families=["zero-rows"], problems=2, quick=True)
    said: list[str] = []
    run_command(request, folder / "out", jobs=1, anew=False, say=said.append)
    before = read_measurements(folder / "out" / "measurements.csv")
    assert [each.outcome for each in before] == ["success"] * 2 + ["silently-wrong"] * 2
    assert not any("anew" in words for words in said)
    (folder / "mended.py").write_text(WRONG.replace("+= 1.0", "+= 0.00"), encoding="utf-8")
    monkeypatch.delitem(sys.modules, "mended")
    run_command(request, folder / "out", jobs=1, anew=False, say=said.append)
    after = read_measurements(folder / "out" / "measurements.csv")
    assert [each.outcome for each in after] == ["success"] * 4
    assert after[:2] == before[:2], "to the last digit of their times"
    assert "Measured anew, since what they were measured on has changed: 1 cell of mended:S." in said


def test_rows_that_are_stale_leave_the_file_before_others_are_measured(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "gone.py").write_text(WRONG, encoding="utf-8")
    settings = ComparisonSettings(solvers=("active-set", "gone:S"), families=("zero-rows", "duplicate"), problems=1)
    finish(settings, folder / "out", {})
    (folder / "gone.py").write_text(WRONG + "# mended\n", encoding="utf-8")
    monkeypatch.setattr("cpgrl_opt.comparison.runner._measure", lambda *_: iter(()))
    part = replace(settings, families=("zero-rows",))
    checkpoint = open_checkpoint(part, folder / "out", {})
    with pytest.raises(KeyError):  # nothing is measured here
        run_comparison(part, checkpoint)
    left = [(each.solver, each.family) for each in read_measurements(checkpoint.path)]
    assert left == [("active-set", "zero-rows"), ("active-set", "duplicate"), ("gone:S", "duplicate")]
    whole = open_checkpoint(settings, folder / "out", {})
    with pytest.raises(KeyError):
        run_comparison(settings, whole)
    assert whole.stale == [("gone:S", "prepared", "duplicate")], "found out once it is asked for"
    (folder / "out" / "keys.csv").unlink()
    whole = open_checkpoint(settings, folder / "out", {})
    with pytest.raises(KeyError):
        run_comparison(settings, whole)
    assert {solver for solver, *_ in whole.stale} == {"active-set"}, "nobody wrote what it was measured on"


CELLS = [("active-set", "prepared", "zero-rows"), ("osqp", "prepared", "zero-rows"), ("osqp", "raw", "duplicate")]


def test_the_version_of_a_package_is_in_the_keys_of_its_solvers(monkeypatch: pytest.MonkeyPatch) -> None:
    before = cell_keys(CELLS)
    assert cell_keys(CELLS) == before
    monkeypatch.setattr(machine, "version", lambda package: "7" if package == "osqp" else "1")
    one = cell_keys(CELLS)
    monkeypatch.setattr(machine, "version", lambda package: "8" if package == "osqp" else "1")
    assert [one[cell] == key for cell, key in cell_keys(CELLS).items()] == [True, False, False]


def test_whatever_draws_solves_and_judges_is_in_every_key_and_what_reports_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    modules = sources_of("cpgrl_opt.comparison.bench").modules
    for name in ("certify", "solvers.active_set", "problems.dependent", "comparison.judgement", "comparison.raw"):
        assert f"cpgrl_opt.{name}" in modules
    assert not any("report" in name or "testing" in name for name in modules)
    before = cell_keys(CELLS)
    monkeypatch.setattr(keys_module, "_ours", lambda: "other sources")
    assert all(before[cell] != key for cell, key in cell_keys(CELLS).items())


class Silent:
    """Says of itself only where it stands in memory."""

    def __init__(self, tolerance: float, act: Callable[[], None] = lambda: None) -> None:
        self.tolerance, self.act, self.other = tolerance, act, object()


class Broken(Silent):
    def __repr__(self) -> str:
        raise RuntimeError


@pytest.mark.parametrize("kind", [Silent, Broken])
def test_the_settings_of_a_solver_without_a_repr_are_its_plain_attributes(kind: type[Silent]) -> None:
    one, other = kind(1e-6), kind(1e-6, lambda: None)
    assert settings_of(one) == settings_of(other)
    assert settings_of(one) != settings_of(kind(1e-8))
    assert "0x" not in " ".join(settings_of(one))


TREE = {
    "solver_a.py": "from pack_a import inner\nimport helper_a\n",
    "helper_a.py": "def late():\n    from pack_a.deep.leaf import value\n",
    "pack_a/__init__.py": "",
    "pack_a/inner.py": "from . import neighbour\nfrom .deep import *\n",
    "pack_a/neighbour.py": "import numpy as np, json\nfrom cpgrl_opt import SOLVERS\n",
    "pack_a/deep/__init__.py": "from ..upward import thing\n",
    "pack_a/deep/leaf.py": "value = 1\n",
    "pack_a/upward.py": "thing = 1\n",
}


def test_a_solver_s_source_is_that_of_all_it_imports_from_beside(folder: Path) -> None:
    for name, text in {**TREE, "pack_a/unused.py": "", "unused_a.py": ""}.items():
        (folder / name).parent.mkdir(exist_ok=True, parents=True)
        (folder / name).write_text(text, encoding="utf-8")
    before = sources_of("solver_a", apart=["cpgrl_opt"])
    assert before.installed == ("numpy",)
    assert len(before.modules) == len(TREE)
    for name, text in TREE.items():
        (folder / name).write_text(f"{text}# mended\n", encoding="utf-8")
        assert sources_of("solver_a", apart=["cpgrl_opt"]) != before, name
        (folder / name).write_text(text, encoding="utf-8")
        assert sources_of("solver_a", apart=["cpgrl_opt"]) == before, name
    for name in ("pack_a/unused.py", "unused_a.py"):
        (folder / name).write_text("x = 1\n", encoding="utf-8")
    assert sources_of("solver_a", apart=["cpgrl_opt"]) == before


def test_what_cannot_be_read_as_python_counts_by_its_bytes(folder: Path) -> None:
    (folder / "torn_b.py").write_bytes(b"import\x00 (")
    one = sources_of("torn_b")
    (folder / "torn_b.py").write_bytes(b"import\x00 )")
    assert sources_of("torn_b").digest != one.digest
    assert sources_of("no_such_module_b").modules == ()


@pytest.mark.parametrize(
    "line",
    [
        'from importlib import import_module\nhelper = import_module("by_call.helper")\n',
        'import importlib\n\ndef late():\n    return importlib.import_module(".helper", __package__)\n',
        'helper = __import__("by_call.helper").helper\n',
    ],
)
def test_a_helper_that_is_imported_by_a_call_counts(folder: Path, line: str) -> None:
    package = folder / "by_call"
    package.mkdir()
    (package / "__init__.py").write_text(line, encoding="utf-8")
    (package / "helper.py").write_text("SCALE = 1.1\n", encoding="utf-8")
    before = sources_of("by_call")
    assert before.modules == ("by_call", "by_call.helper")
    (package / "helper.py").write_text("SCALE = 1.0\n", encoding="utf-8")
    assert sources_of("by_call").digest != before.digest
