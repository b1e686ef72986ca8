"""One line broken on purpose in a copy of the project makes the tests of that line fail; unbroken they pass."""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("cpgrl_opt", "rl", "envs")


@dataclass(frozen=True)
class Mutation:
    """`found`, which stands once in the file, becomes `broken`; `test` is the quickest that should notice."""

    file: str
    found: str
    broken: str
    test: str


MUTATIONS = {
    "the projection P adds the normal part": Mutation(
        "cpgrl_opt/projection.py",
        "np.eye(len(V)) - V @ V.T",
        "np.eye(len(V)) + V @ V.T",
        "cpgrl_opt/test_projection.py",
    ),
    "the projected gradient keeps a transposed part": Mutation(
        "cpgrl_opt/projection.py",
        "g = g - V @ (V.T @ g)",
        "g = g - V[:, ::-1] @ (V.T @ g)",
        "cpgrl_opt/test_projection.py",
    ),
    "the compiled projection turns away from the rows": Mutation(
        "cpgrl_opt/solvers/compiled/_direct.py",
        "small[WEIGHT, i] = small[at.MU, i] * small[at.SCALE, i]",
        "small[WEIGHT, i] = -small[at.MU, i] * small[at.SCALE, i]",
        "cpgrl_opt/test_compiled_conduct.py"
        "::test_the_direct_pass_leaves_rows_that_nearly_depend_to_the_thorough_kernel",
    ),
    "the step restores the wrong way": Mutation(
        "cpgrl_opt/_step_run.py",
        "change += settings.restoration_rate * restoration",
        "change -= settings.restoration_rate * restoration",
        "cpgrl_opt/test_step.py::test_the_usual_way_in_one_compiled_call_gives_the_bits_of_the_long_way",
    ),
    "the referee has the multipliers' sign of eq. 7": Mutation(
        "cpgrl_opt/_evidence.py",
        "kappa * d - g - mu @ J",
        "kappa * d - g + mu @ J",
        "cpgrl_opt/test_certify.py",
    ),
    "the trace forgets": Mutation(
        "rl/estimators/gpomdp.py",
        "self.trace = beta * self.trace + score",
        "self.trace = beta * score",
        "rl/test_gpomdp.py::test_compiled_and_plain_path_agree_to_rounding_on_the_same_draws",
    ),
    "the compiled trace decays twice": Mutation(
        "rl/estimators/finite_gpomdp_kernels.py",
        "L0, L1, L2, L3 = r0 + decay * L0,",
        "L0, L1, L2, L3 = r0 + decay * decay * L0,",
        "rl/test_gpomdp.py::test_compiled_and_plain_path_agree_to_rounding_on_the_same_draws",
    ),
}


@pytest.fixture
def copied(tmp_path):
    for name in (*PACKAGES, "tests"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def pytest_on(copy, *tests):
    """The tests of the copy, whose kernels are cached apart."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(copy),
        "NUMBA_CACHE_DIR": str(copy / "numba"),
        "HYPOTHESIS_PROFILE": "ci",
    }
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *(f"tests/{test}" for test in tests)],
        cwd=copy,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("mutation", MUTATIONS.values(), ids=MUTATIONS)
def test_what_is_broken_stands_once(mutation):
    assert (ROOT / mutation.file).read_text(encoding="utf-8").count(mutation.found) == 1


@pytest.mark.slow
@pytest.mark.parametrize("mutation", MUTATIONS.values(), ids=MUTATIONS)
def test_the_tests_fail_where_a_line_is_broken(copied, mutation):
    file = copied / mutation.file
    file.write_text(file.read_text(encoding="utf-8").replace(mutation.found, mutation.broken), encoding="utf-8")
    run = pytest_on(copied, mutation.test)
    assert run.returncode == pytest.ExitCode.TESTS_FAILED, run.stdout + run.stderr
    assert " failed" in run.stdout.splitlines()[-1], run.stdout


@pytest.mark.slow
def test_they_pass_where_none_is(copied):
    run = pytest_on(copied, *dict.fromkeys(mutation.test for mutation in MUTATIONS.values()))
    assert run.returncode == pytest.ExitCode.OK, run.stdout + run.stderr
