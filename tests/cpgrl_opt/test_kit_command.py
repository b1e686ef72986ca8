"""`cpgrl check`: exit status, messages, and a counterexample that runs when pasted."""

import os
import re
import subprocess
import sys
from contextlib import nullcontext
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from cpgrl_opt import SOLVERS
from cpgrl_opt.isolation import Isolated
from cpgrl_opt.testing import LAWS, LawError, check_direction_solver
from cpgrl_opt.testing import command as command_module
from cpgrl_opt.testing.command import check_target, run_check
from cpgrl_opt.testing.target import TargetError
from rl.cli import app

SOLVERS_OF_A_USER = '''
import os, signal, time
import numpy as np
from cpgrl_opt import SOLVERS, Direction, Status

class Good:
    def solve(self, problem):
        return SOLVERS["enumeration"].solve(problem)

    def __repr__(self):
        return "Good()"

good = Good()

class Normalising(Good):
    """Broken: a direction of length 1."""

    def solve(self, problem):
        found = super().solve(problem)
        size = (found.value @ found.value) ** 0.5
        return Direction(found.value / (size or 1.0), found.multipliers, found.status)

def ascent(g, J, b):
    return g

class Loud(Good):
    def solve(self, problem):
        print("Optimal solution found!")
        os.write(1, b"from C")
        return super().solve(problem)

class Hanging(Good):
    def solve(self, problem):
        while problem.m >= 2:
            time.sleep(1)
        return super().solve(problem)

class Leaving(Good):
    def solve(self, problem):
        if problem.m >= 2:
            os._exit(7)
        return super().solve(problem)

class Greedy(Good):
    def solve(self, problem):
        if problem.m >= 2:
            np.ones(2**34)
        return super().solve(problem)

class Ended(Normalising):
    """Somebody ends the command when the first counterexample is being shrunk."""
    asked = 0

    def solve(self, problem):
        Ended.asked += 1
        if Ended.asked == 15:
            os.kill(os.getpid(), signal.SIGTERM)
        return super().solve(problem)

class NeedsAPackage:
    def solve(self, problem):
        raise ImportError("solver 'x' needs the package y; type: pip install y")

class TakesNothing(Good):
    def supports(self, problem):
        return False

class Lenient(Good):
    tolerance = 10

class NeedsAnArgument:
    def __init__(self, size):
        pass

class TakesTwo:
    def solve(self, g, J):
        pass

def one_argument(g):
    return g

number = 3
'''


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in [name for name in sys.modules if name.startswith("users_")]:
        monkeypatch.delitem(sys.modules, name)
    (tmp_path / "users_solvers.py").write_text(SOLVERS_OF_A_USER, encoding="utf-8")
    return tmp_path


LIMITS = {}  # that the command has asked for
A_FEW = {
    f"check_{name}": LAWS[f"check_{name}"]
    for name in ("stationarity", "primal_feasibility", "silence", "batch_is_loop")
}


@pytest.fixture
def cpgrl_check(folder, monkeypatch):
    """The command in this process, with a few of the laws."""
    monkeypatch.setattr(command_module, "Isolated", lambda make, **limits: LIMITS.update(limits) or nullcontext(make()))
    monkeypatch.setattr(command_module, "LAWS", A_FEW)
    monkeypatch.setattr("cpgrl_opt.testing.examination._SHRINKING_CALLS", 12)
    return lambda *arguments: CliRunner().invoke(app, ["check", "--max-examples", "6", *map(str, arguments)])


def test_a_good_solver_exits_with_0_and_a_row_for_every_law(cpgrl_check):
    result = cpgrl_check("users_solvers:good", "--time-limit", 7, "--memory-limit", 3)
    assert result.exit_code == 0, result.output
    assert LIMITS == {"time_limit": 7.0, "memory_limit": 3 * 2**30}
    rows = {line.split()[0]: line.split()[1:] for line in result.stdout.splitlines() if line.count(" ") > 5}
    assert rows["law"] == ["run", "declined", "skipped", "expected", "failed"]
    assert list(rows)[1:5] == [name.removeprefix("check_") for name in A_FEW]
    assert rows["stationarity"] == ["6", "0", "0", "0", "0", "held"]
    assert rows["batch_is_loop"][-1] == "n/a"
    assert "Tolerance 1e-06, 6 examples a law, seed 0." in result.stdout
    assert "users_solvers:good passes: of 4 laws 3 held, 1 unsupported." in result.stdout


def test_a_bad_solver_exits_with_1_and_a_counterexample_that_runs_when_pasted(cpgrl_check, folder):
    result = cpgrl_check("users_solvers:Normalising", "--markdown", folder / "verdict.md")
    assert result.exit_code == 1
    verdict = (folder / "verdict.md").read_text(encoding="utf-8")
    assert verdict.startswith("# Verdict on users_solvers:Normalising\n")
    assert verdict.count("```python\n") == verdict.count("FAILED\n") >= 2
    assert "verdict.md" in result.stdout
    assert "FAILED: " in result.stdout
    assert "Look at the sign of μ" in result.stdout
    source = result.stdout[result.stdout.index("from cpgrl_opt import") :].partition("    gradient   ")[0]
    assert "from users_solvers import Normalising" in source
    scope = {}
    exec(source, scope)
    (test,) = [value for name, value in scope.items() if name.startswith("test_")]
    with pytest.raises(LawError):
        test()
    (folder / "users_solvers.py").write_text(SOLVERS_OF_A_USER.replace("size or 1.0", "1.0"), encoding="utf-8")
    sys.modules.pop("users_solvers")
    exec(source, scope)
    scope[test.__name__]()  # holds once the solver is right


def test_a_plain_function_is_checked_through_the_adapter(cpgrl_check):
    result = cpgrl_check("users_solvers:ascent")
    assert result.exit_code == 1
    assert "FAILED: primal_feasibility" in result.stdout
    assert "FunctionSolver(ascent)" in result.stdout
    assert "FAILED: stationarity" not in result.stdout  # d = g with μ = 0


def test_an_expected_failure_is_excused_with_its_reason(cpgrl_check):
    result = cpgrl_check("users_solvers:Loud", "--expected-failure", "silence=prints a banner")
    assert result.exit_code == 0, result.output
    assert "expected: prints a banner" in result.stdout
    assert next(line for line in result.stdout.splitlines() if line.startswith("silence")).endswith("6      0  excused")


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("users_solvers", "should be package.module:SOLVER"),
        ("users_solvers:Goode", "no 'Goode' but Good"),
        ("users_nowhere:x", "no module 'users_nowhere'"),
        ("users_solvers:number", "found 3, without a method solve"),
        ("users_solvers:NeedsAnArgument", "constructible without arguments"),
        ("users_solvers:one_argument", "function should take (gradient, jacobian, bound)"),
        ("users_solvers:NeedsAPackage", "pip install y"),
        ("users_solvers:Lenient", "users_solvers:Lenient: tolerance should be a number in (0, 0.001]; found 10"),
    ],
)
def test_what_cannot_be_checked_exits_with_2_and_one_line(cpgrl_check, target, words):
    result = cpgrl_check(target)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.startswith("cpgrl: ")
    assert result.stderr.count("\n") == 1
    assert words in result.stderr


def test_a_solver_that_takes_no_problem_cannot_be_checked(cpgrl_check, monkeypatch):
    monkeypatch.setattr(command_module, "LAWS", {"check_stationarity": LAWS["check_stationarity"]})
    result = cpgrl_check("users_solvers:TakesNothing")
    assert result.exit_code == 2
    assert "should take some of the laws' problems" in result.stderr


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--memory-limit", "inf", "memory_limit should be a finite number > 0; found inf"),
        ("--seed", "-1", "seed should be an integer ≥ 0; found -1"),
        ("--markdown", "nowhere/verdict.md", "markdown should be a file in a folder that exists"),
        ("--markdown", "x" * 300, "File name too long"),
        ("--expected-failure", "silence", "expected_failure should be CHECK=REASON; found 'silence'"),
        ("--expected-failure", "silnce=x", "check in expected_failure should be one of check_"),
    ],
)
def test_a_bad_option_exits_with_2_and_what_it_should_be(cpgrl_check, option, value, words):
    result = cpgrl_check("users_solvers:good", option, value)
    assert result.exit_code == 2
    assert words in result.stderr
    assert result.stderr.count("\n") == 1


def test_a_module_that_fails_shows_its_own_traceback_and_none_of_ours(cpgrl_check, folder):
    (folder / "users_broken.py").write_text("def f():\n    return 1 / 0\n\nf()\n", encoding="utf-8")
    result = cpgrl_check("users_broken:f")
    assert result.exit_code == 2
    assert "users_broken.py" in result.stderr
    assert "subject.py" not in result.stderr
    assert result.stderr.splitlines()[-1] == (
        "cpgrl: users_broken should be importable; found ZeroDivisionError: division by zero"
    )


def test_a_process_of_its_own_finds_the_current_folder_and_keeps_noise_from_stdout(folder):
    """In a locale that knows no λ, to which the output goes."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        [sys.executable, "-m", "rl.cli", "check", "users_solvers:Loud", "--max-examples", "1"],
        capture_output=True, text=True, timeout=300, env=environment | {"LC_ALL": "C", "PYTHONUTF8": "0"},
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert [line for line in lines if "Optimal solution" in line and "should print nothing" not in line] == []
    assert lines[-1].endswith(" unsupported, 1 FAILED.")


@pytest.mark.parametrize(
    ("solver", "words"),
    [
        pytest.param("Hanging", r"found no answer within 2 s; it was at .* in solve", marks=pytest.mark.slow),
        ("Leaving", r"found the end of the process \(exit code 7\)"),
        ("Greedy", r"it raised MemoryError: Unable to allocate 128. GiB"),
    ],
)
def test_hangs_crashes_and_greed_shrink(folder, monkeypatch, solver, words):
    """They come where m ≥ 2; what is shown is about the least that does it."""
    import users_solvers

    monkeypatch.setattr("cpgrl_opt.testing.examination._FEW_CALLS", 0)
    with Isolated(getattr(users_solvers, solver)(), time_limit=20.0, memory_limit=2**33) as room:
        check = "check_gradient_kept_when_feasible"
        result = check_direction_solver(room, checks=[check], max_examples=8)[check]
    assert result.failed >= 1
    assert re.search(words, result.problem), result.problem
    scope, asked = {}, []
    exec(result.counterexample, scope)
    spy = SimpleNamespace(solve=lambda problem: asked.append(problem) or SOLVERS["nnls"].solve(problem))
    scope["test_gradient_kept_when_feasible_holds_here"](spy)
    assert asked[0].m >= 2
    assert asked[0].jacobian.size <= 9


def test_a_request_to_end_is_not_shrunk_and_there_is_no_verdict(cpgrl_check):
    """Hypothesis took it for a failure of the test, and went on to look for a smaller problem that ends the command."""
    result = cpgrl_check("users_solvers:Ended")
    assert (result.exit_code, result.stdout) == (143, "")
    assert sys.modules["users_solvers"].Ended.asked == 15


def test_a_module_that_never_imports_is_refused(folder, monkeypatch):
    monkeypatch.setattr("cpgrl_opt.isolation._process.START_LIMIT", 0.05)
    with pytest.raises(TargetError, match="should import and answer a problem; found no answer within"):
        check_target("users_solvers:good")


def test_ctrl_c_exits_with_130(monkeypatch, capsys):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(command_module, "check_target", interrupt)
    assert run_check("a:b") == 130
    assert "Interrupted" in capsys.readouterr().err


@pytest.mark.parametrize(("solver", "status"), [("good", 2), ("Normalising", 1)])
def test_a_verdict_that_cannot_be_written_is_still_printed(cpgrl_check, folder, monkeypatch, solver, status):
    def fill(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_text", fill)
    result = cpgrl_check(f"users_solvers:{solver}", "--markdown", folder / f"{'λ' * 120}.md")
    assert result.exit_code == status
    assert "of 4 laws" in result.stdout
    assert result.stderr == "cpgrl: the verdict could not be written: [Errno 28] No space left on device\n"
    assert not list(folder.glob("*.part"))


def test_a_verdict_may_go_to_what_is_no_file(cpgrl_check, folder):
    os.mkfifo("pipe")
    with subprocess.Popen(["cat", "pipe"], stdout=subprocess.PIPE, text=True, encoding="utf-8") as reader:
        assert cpgrl_check("users_solvers:good", "--markdown", "pipe").exit_code == 0
        assert reader.stdout.read().startswith("# Verdict on users_solvers:good")
    assert not (folder / "pipe").is_file()
