import sys

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, DirectionProblem
from cpgrl_opt.comparison.export import COLUMNS, export_recording, write_test_set
from cpgrl_opt.comparison.recording import Recording, shipped_recording

PROBLEMS = [
    DirectionProblem([1.0, -2.0, 0.5], [[1.0, 0.2, 0.0], [0.0, 1.0, -1.0]], bound=[0.5, -np.inf]),
    DirectionProblem([1.0, -2.0, 0.5], [[1.0, 0.2, 0.0], [0.0, 1.0, -1.0]], bound=[0.5, 0.1], equality=[False, True]),
    DirectionProblem([1.0, 2.0], [[1.0, 0.0]], bound=[-np.inf]),
    DirectionProblem([1.0, 2.0], [[1.0, 1.0]], equality=True),
    DirectionProblem([1.0, 2.0], [[1.0, 1.0]], bound=[4.0], metric=[[2.0, 0.5], [0.5, 1.0]]),
    DirectionProblem([1.0, 2.0], [[1.0, 1.0]], bound=[4.0], metric=[2.0, 0.5]),
]


def as_qpbenchmark_reads(path):
    """Its rule: matrices are rows of q's size; what is no array is passed on as it is. Yields keyword arguments."""
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed: the extra 'export'")
    table = parquet.read_table(path)
    assert tuple(table.column_names) == (*COLUMNS, "name")
    for row in table.to_pylist():
        name, n = row.pop("name"), len(row["q"])
        arrays = {key: value if value is None else np.array(value) for key, value in row.items()}
        for key in ("P", "G", "A"):
            if arrays[key] is not None:
                arrays[key] = arrays[key].reshape(-1, n)
        yield name, arrays


def test_a_test_set_read_back_has_the_same_solutions(tmp_path):
    pytest.importorskip("pyarrow", reason="pyarrow is not installed: the extra 'export'")
    qpsolvers = pytest.importorskip("qpsolvers")
    write_test_set(PROBLEMS, list("uvwxyz"), tmp_path / "set.parquet")
    read = list(as_qpbenchmark_reads(tmp_path / "set.parquet"))
    assert [name for name, _ in read] == list("uvwxyz")
    for problem, (_, arrays) in zip(PROBLEMS, read, strict=True):
        solution = qpsolvers.solve_problem(qpsolvers.Problem(**arrays), "quadprog")
        np.testing.assert_allclose(solution.x, SOLVERS["active-set"].solve(problem).value, atol=1e-9)


def test_a_recording_is_exported_bit_for_bit_under_names_that_tell_where_problems_come_from(tmp_path):
    pytest.importorskip("pyarrow", reason="pyarrow is not installed: the extra 'export'")
    recording = shipped_recording("three-state").select(slice(0, 70))
    export_recording(recording, tmp_path / "set.parquet")
    read = list(as_qpbenchmark_reads(tmp_path / "set.parquet"))
    assert len({name for name, _ in read}) == len(read) == 70
    assert read[1][0] == f"cpgrl-run0-episode{recording.episode[1]}-restoration"
    for problem, (_, arrays) in zip(recording.problems, read, strict=True):
        assert np.array_equal(arrays["q"], -problem.gradient)
        assert np.array_equal(arrays["A"], problem.jacobian[problem.equality])
        assert np.array_equal(arrays["b"], problem.bound[problem.equality])
        assert arrays["G"] is None


def test_without_pyarrow_the_message_is_what_to_type(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ImportError, match=r"pip install 'cpgrl-opt\[export\]'"):
        write_test_set(PROBLEMS[:1], ["x"], tmp_path / "set.parquet")


def test_a_trust_region_is_no_quadratic_program(tmp_path):
    with pytest.raises(ValueError, match="should have no radius"):
        write_test_set([DirectionProblem([1.0], [[1.0]], radius=1.0)], ["x"], tmp_path / "set.parquet")


def test_problems_of_one_update_have_names_that_differ(tmp_path):
    """An update that drops twice asks for three tangents and three restorations: six problems."""
    pytest.importorskip("pyarrow", reason="pyarrow is not installed: the extra 'export'")
    names = [
        f"{training}-run1-episode3-{part}"
        for training in ("toy", "toy-run1")
        for part in ("tangent", "restoration", *["tangent-after-a-drop", "restoration-after-a-drop"] * 2)
    ]
    part = np.array([0, 1, 2, 3, 2, 3] * 2)
    recording = Recording(
        gradient=np.arange(24.0).reshape(12, 2), jacobian=np.ones((12, 1, 2)), bound=np.zeros((12, 1)),
        equality=np.ones((12, 1), bool), training=np.repeat([0, 1], 6), run=np.ones(12, int),
        episode=np.full(12, 3), part=part, stretch=np.zeros(12, int), trainings=("toy", "toy-run1"), selection="",
    )  # fmt: skip
    export_recording(recording, tmp_path / "set.parquet")
    read = list(as_qpbenchmark_reads(tmp_path / "set.parquet"))
    again = [*names[:4], f"{names[2]}-2", f"{names[3]}-2"], [*names[6:10], f"{names[8]}-2", f"{names[9]}-2"]
    assert [name for name, _ in read] == again[0] + again[1]
    assert [arrays["q"][0] for _, arrays in read] == [-2.0 * k for k in range(12)]
    assert [path.name for path in tmp_path.iterdir()] == ["set.parquet"]


def test_one_name_for_two_problems_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"names should differ, .*; found 'x' twice"):
        write_test_set(PROBLEMS[:2], ["x", "x"], tmp_path / "set.parquet")
