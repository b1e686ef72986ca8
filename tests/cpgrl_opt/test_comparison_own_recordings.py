"""A user's own recording is a family of the comparison, and a sequence for the benchmark of warm starts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cpgrl_opt.comparison.command import Request, compare
from cpgrl_opt.comparison.families import FAMILIES
from cpgrl_opt.comparison.named_families import families_asked, family_named
from cpgrl_opt.comparison.recording import Recording, empty_recording, shipped_recording

from .comparisons import BenchHere

MIXED = Request(solvers=["active-set"], families=["own.npz", "zero-rows"], problems=6)


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Recording:
    """own.npz in the current folder: two problems met, and between them one that is infeasible."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("cpgrl_opt.comparison.runner.isolated_bench", BenchHere)
    recording = shipped_recording("three-state").select(slice(0, 3))
    jacobian, bound, equality = recording.jacobian.copy(), recording.bound.copy(), recording.equality.copy()
    jacobian[1, 1], bound[1], equality[1] = -jacobian[1, 0], [1.0, 1.0, -np.inf], False
    recording = replace(recording, jacobian=jacobian, bound=bound, equality=equality)
    recording.save(Path("own.npz"))
    return recording


def test_a_recording_is_compared_beside_named_families_and_resumed(
    own: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = compare(MIXED, Path("out"))
    assert [each.family for each in done.measurements] == ["zero-rows"] * 6 + ["own.npz"] * 6
    assert {each.outcome for each in done.measurements} == {"success"}
    verdicts = {each.status for each in done.measurements if each.family == "own.npz"}
    assert verdicts == {"OPTIMAL", "INFEASIBLE"}, "feasible and infeasible problems are judged one by one"
    assert "| `own.npz` | problems met in training" in Path("out/report.md").read_text(encoding="utf-8")

    monkeypatch.setattr("cpgrl_opt.comparison.runner.isolated_bench", None)  # nothing is left to measure
    assert compare(MIXED, Path("out")).measurements == done.measurements
    assert compare(replace(MIXED, families=["./own.npz"]), Path("out")).kept == 1


def test_another_recording_at_the_same_path_is_measured_anew(own: Recording, tmp_path: Path) -> None:
    before = compare(MIXED, Path("out"))
    own.select(slice(0, 1)).save(Path("own.npz"))
    after = compare(MIXED, Path("out"))
    assert after.renewed == [("active-set", "prepared", "own.npz")]
    assert after.measurements[:6] == before.measurements[:6], "of the other family, to the last digit of their times"
    assert {each.status for each in after.measurements[6:]} == {"OPTIMAL"}
    assert "INFEASIBLE" in {each.status for each in before.measurements[6:]}


def test_a_file_that_changes_is_read_again(own: Recording) -> None:
    assert not family_named("own.npz").feasible
    own.select(slice(0, 1)).save(Path("own.npz"))
    assert family_named("own.npz").feasible


def test_each_problem_is_feasible_or_not_by_itself(own: Recording) -> None:
    family = family_named("own.npz")
    assert [family.is_feasible(problem) for problem in own.problems] == [True, False, True]
    assert FAMILIES["zero-rows"].is_feasible(FAMILIES["zero-rows"].problem(0, 0))


@pytest.mark.usefixtures("own")
def test_a_bad_file_is_refused_in_words() -> None:
    Path("text.npz").write_text("no recording", encoding="utf-8")
    empty_recording(["x"], "").save(Path("empty.npz"))
    for name, message in (
        ("nosuch.npz", r"nosuch\.npz should be a recording, .*; found no such file"),
        ("text.npz", r"text\.npz should be a recording, an \.npz"),
        ("empty.npz", r"empty\.npz should hold at least one problem to be a family; found none"),
        ("own", r"family should be one of well-conditioned, .*, or a recording, FILE\.npz; found 'own'"),
    ):
        with pytest.raises(ValueError, match=message):
            Request(families=[name], solvers=["active-set"]).settings()
    assert list(families_asked(["own.npz", "zero-*", "./own.npz"])) == ["zero-rows", "zero-rows-equality", "own.npz"]
