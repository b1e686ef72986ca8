"""The compiled kernels' conduct: batches, tangent faces, inputs, NaN, the compiled referee, the cache."""

import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cpgrl_opt import Direction, DirectionProblem, ProblemBatch
from cpgrl_opt.solvers.exact_core import project, project_batch
from cpgrl_opt.solvers.thorough import solve_thoroughly

TOLERANCE = 1e-12
Data = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def rng_for(seed: int) -> np.random.Generator:
    return np.random.default_rng([20061119, seed])


def solved(data: Data, *, tangent: bool = False) -> Direction:
    return project(DirectionProblem.trusted(*data), TOLERANCE, tangent=tangent)


def touching(rng: np.random.Generator, m: int, n: int) -> Data:
    """Inequalities that a random point meets, about half of them exactly."""
    J = rng.normal(size=(m, n))
    b = J @ rng.normal(size=n) - rng.random(m) * (rng.random(m) < 0.5)
    return rng.normal(size=n), J, b, np.zeros(m, dtype=bool)


def nearly_opposing(rng: np.random.Generator) -> Data:
    g, J, b, E = touching(rng, 4, 5)
    J[1] = -J[0] + 1e-9 * J[1]
    return g, J, np.minimum(b, 0.0), E


def impossible(rng: np.random.Generator) -> Data:
    g, J, b, E = touching(rng, 4, 5)
    J[1], b[1] = -J[0], 0.1 - b[0]
    return g, J, b, E


def mixed(rng: np.random.Generator) -> Data:
    g, J, b, _ = touching(rng, 5, 6)
    return g, J, b, np.array([True, True, False, False, False])


@pytest.mark.parametrize("tangent", [False, True])
def test_a_batch_is_a_loop_bit_for_bit(tangent: bool) -> None:
    rng = rng_for(6)
    draws = [draw(rng) for draw in (nearly_opposing, impossible) for _ in range(8)]
    draws += [touching(rng, 4, 5) for _ in range(8)]
    draws = [(g, J, b, E | tangent) for g, J, b, E in draws]
    g, J, b, E = (np.stack(part) for part in zip(*draws, strict=True))
    batch = project_batch(ProblemBatch.trusted(g, J, b, E), TOLERANCE, tangent=tangent)
    for data, together in zip(draws, batch, strict=True):
        one = solved(data, tangent=tangent)
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


@pytest.mark.parametrize("draw", [touching, mixed], ids=lambda draw: draw.__name__)
def test_the_direct_pass_and_the_thorough_kernel_agree(draw) -> None:
    rng, answered = rng_for(11), 0
    for _ in range(50):
        g, J, b, E = draw(rng, 4, 6) if draw is touching else draw(rng)
        [thorough] = solve_thoroughly(ProblemBatch.trusted(g[None], J[None], b[None], E[None]), TOLERANCE)
        direct = directly(g, J, b, E)
        if direct is not None:
            answered += 1
            np.testing.assert_allclose(direct.value, thorough.value, rtol=0, atol=1e-11 * np.abs(g).max())
            np.testing.assert_allclose(direct.multipliers, thorough.multipliers, rtol=1e-9, atol=1e-11)
    assert answered >= 45


def test_the_direct_pass_leaves_rows_that_nearly_depend_to_the_thorough_kernel() -> None:
    for angle, taken in ((1e-1, True), (1e-3, False), (1e-9, False)):
        rows = np.array([[1.0, 0.0, 0.0], [-np.cos(angle), np.sin(angle), 0.0]])
        answer = directly(np.array([0.0, -1.0, 1.0]), rows, np.zeros(2), np.ones(2, dtype=bool))
        assert (answer is not None) == taken
    copied = directly(np.ones(3), np.array([[1.0, 2.0, 3.0], [2.0, 4.0, 6.0]]), np.zeros(2), np.ones(2, dtype=bool))
    assert copied is not None


def directly(g: np.ndarray, J: np.ndarray, b: np.ndarray, E: np.ndarray) -> SimpleNamespace | None:
    from cpgrl_opt.solvers.compiled._direct import OPTIMAL, project_directly

    d, mu, report = np.empty(J.shape[1]), np.empty(len(J)), np.empty(6)
    project_directly(False, g, J, b, E, TOLERANCE, d, mu, report)
    return SimpleNamespace(value=d, multipliers=mu) if report[0] == OPTIMAL else None
