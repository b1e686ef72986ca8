"""The compiled kernels' conduct: batches, tangent faces, the cache."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from cpgrl_opt import ProblemBatch
from cpgrl_opt.problems import Case, draw_problem
from cpgrl_opt.solvers.exact_core import project, project_batch

TOLERANCE = 1e-12


@pytest.mark.parametrize("tangent", [False, True])
def test_a_batch_is_a_loop_bit_for_bit(tangent: bool) -> None:
    names = ("almost opposing", "infeasible", "ordinary")
    case = Case.AFFINE if tangent else Case.BOUNDS
    drawn = [draw_problem(name, np.random.default_rng([6, k]), case, n=5, m=4) for name in names for k in range(8)]
    batch = project_batch(ProblemBatch.stack(drawn), TOLERANCE, tangent=tangent)
    for problem, together in zip(drawn, batch, strict=True):
        one = project(problem, TOLERANCE, tangent=tangent)
        assert (one.status, one.iterations) == (together.status, together.iterations)
        np.testing.assert_array_equal(one.value, together.value)
        np.testing.assert_array_equal(one.multipliers, together.multipliers)


def test_a_change_in_any_file_of_the_kernels_outdates_their_cache(tmp_path: Path) -> None:
    from cpgrl_opt import machine_code

    (tmp_path / "__pycache__").mkdir()
    for name in ("entry.py", "helper.py"):
        shutil.copy(machine_code.__file__, tmp_path / name)
        os.utime(tmp_path / name, (100, 100))
    index = tmp_path / "__pycache__" / "entry.kernel-1.py311.nbi"
    index.touch()
    os.utime(index, (200, 200))
    machine_code.forget_outdated_kernels(tmp_path)
    assert index.exists()
    os.utime(tmp_path / "helper.py", (300, 300))
    machine_code.forget_outdated_kernels(tmp_path)
    assert not index.exists()
