"""A package that is there but cannot be imported, e.g. for want of a system library, is in nobody's way."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cpgrl_opt import SOLVERS, DirectionProblem
from cpgrl_opt.comparison.command import Request, run_command
from cpgrl_opt.solvers import UnusablePackageError, is_installed, is_usable, obstacle
from cpgrl_opt.solvers.packages import require_packages
from rl.cli import app
from rl.experiments.three_state import ThreeStateExperiment

from .comparisons import finish

LIBGOMP = "libgomp.so.1: cannot open shared object file"
Break = Callable[..., None]


@pytest.fixture
def break_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Break:
    """Puts a package of that name in front of the true one; its import raises."""
    for name in ("daqp", "cvxpy"):  # qpsolvers and CVXPY remember what they could not import
        obstacle(SOLVERS[name])

    def break_it(package: str, raised: str = f"ImportError({LIBGOMP!r})") -> None:
        folder = tmp_path / "broken" / package
        folder.mkdir(parents=True)
        (folder / "__init__.py").write_text(f"raise {raised}", encoding="utf-8")
        monkeypatch.syspath_prepend(folder.parent)
        monkeypatch.delitem(sys.modules, package, raising=False)

    return break_it


@pytest.mark.parametrize(("package", "name"), [("osqp", "osqp"), ("clarabel", "cvxpy"), ("qpsolvers", "daqp")])
def test_a_broken_package_is_installed_and_not_usable_and_says_why(
    package: str, name: str, break_package: Break
) -> None:
    break_package(package)
    assert is_installed(SOLVERS[name])
    assert not is_usable(SOLVERS[name])
    assert obstacle(SOLVERS[name]) == f"broken: {LIBGOMP}"
    assert is_usable(SOLVERS["active-set"])
    match = rf"{name}.*{package}, which is installed but cannot be imported: libgomp\.so\.1"
    with pytest.raises(UnusablePackageError, match=match):
        SOLVERS[name].solve(DirectionProblem([1.0, 1.0], [[-1.0, 0.0]]))
    with pytest.raises(UnusablePackageError, match=match):  # before a training, not in its middle
        require_packages(SOLVERS[name])


def test_any_exception_of_an_import_is_told(break_package: Break) -> None:
    break_package("scs", "OSError('no such file')")
    assert obstacle(SOLVERS["scs"]) == "broken: OSError: no such file"


def test_a_comparison_of_all_goes_on_with_the_others_and_says_so(
    break_package: Break, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    break_package("proxsuite")
    two = {name: SOLVERS[name] for name in ("active-set", "proxqp")}
    monkeypatch.setattr("cpgrl_opt.comparison.contestants.SOLVERS", two)
    request = Request(quick=True, families=["zero-rows"], problems=1)
    settings, absent = request.settings()
    assert settings.solvers == ("active-set",)
    assert absent == {"proxqp": f"broken: {LIBGOMP}"}
    finish(settings, tmp_path, {})
    monkeypatch.setattr("cpgrl_opt.isolation.process_group.Popen", None)  # no worker is needed
    said: list[str] = []
    run_command(request, tmp_path, jobs=1, anew=False, say=said.append)
    assert said[0] == f"proxqp is broken: {LIBGOMP}, so that it is not compared; see `cpgrl solvers`."
    assert f"| proxsuite | broken: {LIBGOMP} |" in (tmp_path / "report.md").read_text(encoding="utf-8")


def test_the_trainings_compared_are_those_of_the_solvers_that_can_be_used(break_package: Break) -> None:
    break_package("osqp")
    compared = {case.solver for case in ThreeStateExperiment(compare=True).compared}
    assert "osqp" not in compared
    assert "active-set" in compared


def test_the_list_of_solvers_says_why_one_is_broken(break_package: Break, monkeypatch: pytest.MonkeyPatch) -> None:
    break_package("proxsuite", "ImportError('[red] libgomp')")
    monkeypatch.setenv("COLUMNS", "250")
    result = CliRunner().invoke(app, ["solvers"])
    assert result.exit_code == 0
    (line,) = [line for line in result.output.splitlines() if "proxqp" in line]
    assert "broken: [red] libgomp" in line


@pytest.mark.parametrize("parameter", ["proxqp", SOLVERS["proxqp"]], ids=["name", "solver"])
def test_tests_of_a_broken_solver_are_skipped_with_the_reason(
    parameter: object, break_package: Break, request: pytest.FixtureRequest
) -> None:
    conftest = request.config.pluginmanager.get_plugin(str(Path(__file__).parents[1] / "conftest.py"))
    assert conftest is not None
    conftest.skip_broken(["active-set", SOLVERS["nnls"], "no solver", 1.0, None, [parameter]])
    break_package("proxsuite")
    with pytest.raises(pytest.skip.Exception, match=r"proxqp is broken: libgomp\.so\.1"):
        conftest.skip_broken([parameter])
