"""The README tells the truth: its examples run, its table is that of SOLVERS, its commands are the ones CI runs."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, ConstrainedStep, DirectionProblem, Linearization, Status
from cpgrl_opt.comparison.exact import exact_answer
from cpgrl_opt.comparison.families import FAMILIES
from cpgrl_opt.testing import LAWS, FunctionSolver
from cpgrl_opt.testing.examination import first_break
from rl.experiments.solver_cases import cases

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
# Arguments of the `cpgrl` that the README installs.
CPGRL = [line.split() for line in re.findall(r"^\.venv/bin/cpgrl (.*)$", README, flags=re.MULTILINE)]
CHECKS = [arguments for arguments in CPGRL if arguments[0] == "check"]


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_an_example_runs_as_printed(number):
    exec(compile(EXAMPLES[number], f"README example {number + 1}", "exec"), {})


def test_there_are_examples():
    assert len(EXAMPLES) >= 3
    assert max(len(example.splitlines()) for example in EXAMPLES) <= 16


def test_the_table_of_solvers_is_that_of_the_code():
    found = [line for line in README.splitlines() if re.match(r"\| `[a-z-]+` \|", line)]
    expected = [
        f"| `{name}` | {', '.join(cases(solver))} | {solver.guarantee} | {solver.source} |"
        for name, solver in SOLVERS.items()
    ]
    missing, gone = [row for row in expected if row not in found], [row for row in found if row not in expected]
    advice = ["README.md's table of solvers should have these rows, in the order of SOLVERS:", *missing]
    advice += ["and no longer:", *gone] if gone else []
    assert found == expected, "\n".join(advice)


@pytest.mark.parametrize(
    ("marker", "program"), [("reproduce command", "cpgrl reproduce three-state"), ("test command", "pytest")]
)
def test_each_command_makes_its_own_environment_with_pip_alone(marker, program):
    command = re.search(rf"<!-- {marker} -->\n```sh\n(.*)\n```", README)
    assert command, f"README.md should hold one line behind <!-- {marker} -->"
    venv = re.match(r"python3 -m venv (\S+) && \1/bin/pip install ", command[1])
    assert venv, f"the command should make its own environment; found {command[1]!r}"
    assert f"{venv[1]}/bin/{program.split()[0]}" in command[1]
    assert program in command[1]


def test_it_says_which_formulation_is_cpos_problem():
    """A constraint that is met with slack 0.05 holds CPO back, and `linearized`; not `restoring`."""
    assert 'formulation="linearized", metric=M, radius=0.1, restoration_rate=1.0)` is CPO\'s problem' in README
    gradient, row, slack = [-1.0, 0.3], [[1.0, 0.0]], 0.05
    cpo = SOLVERS["active-set"].solve(DirectionProblem(gradient, row, -slack, radius=1.0))
    for formulation, is_cpo in (("linearized", True), ("restoring", False)):
        step = ConstrainedStep(formulation=formulation, restoration_rate=1.0, radius=1.0)
        change = step(Linearization([0.0, slack], [gradient, *row]), [0.0]).change
        assert np.allclose(change, cpo.value) == is_cpo


def test_it_says_how_far_off_a_certified_answer_may_be():
    """1e-12 rad from opposing; where it said "an eighth" there were 38 %."""
    said = re.search(r"`active-set` is exact at 1e-10 rad, and up to (\d+) % off at 1e-12", README)
    assert said
    problems = [FAMILIES["opposing-1e-12"].problem(k, 0) for k in range(60)]
    found = [(problem, exact_answer(problem), SOLVERS["active-set"].solve(problem)) for problem in problems]
    off = [
        np.linalg.norm(answer.value - exact.direction) / np.linalg.norm(problem.gradient)
        for problem, exact, answer in found
        if exact.feasible and answer.status == Status.OPTIMAL
    ]
    assert 0.25 * int(said[1]) / 100 < max(off) <= int(said[1]) / 100


@pytest.mark.parametrize("name", re.findall(r"\]\(([^):]+)\)", README))
def test_every_linked_file_exists(name):
    assert (ROOT / name.split("#")[0]).exists()


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A folder with the README's mine.py in it, which is where its commands are typed."""
    (source,) = [example for example in EXAMPLES if "class Doubtful" in example]
    assert "`mine.py`:\n\n```python\n" + source in README
    (tmp_path / "mine.py").write_text(source, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def typed(start_cpgrl, *arguments):
    """(exit status, stdout) of `cpgrl`."""
    command = start_cpgrl(*arguments)
    out, _ = command.communicate()
    return command.returncode, out


def test_two_solvers_are_checked():
    assert [arguments[1] for arguments in CHECKS] == ["mine:Doubtful", "mine:tangent"]


def test_the_solvers_of_mine_are_what_they_are_said_to_be():
    """Two laws, for the whole of it is slow."""
    (source,) = [example for example in EXAMPLES if "class Doubtful" in example]
    scope = {}
    exec(compile(source, "mine.py", "exec"), scope)
    for law in ("check_stationarity", "check_gradient_kept_when_feasible"):
        found = first_break(LAWS[law], scope["Doubtful"](), max_examples=20)
        assert (found.held, found.broken) == (20, 0)
    assert first_break(LAWS[law], FunctionSolver(scope["tangent"]), max_examples=20).broken == 1


@pytest.mark.slow
def test_the_first_solver_of_mine_passes(mine, start_cpgrl):
    status, out = typed(start_cpgrl, *CHECKS[0])
    assert status == 0, out
    assert "mine:Doubtful passes" in out


@pytest.mark.slow
def test_the_second_breaks_half_of_the_laws_with_a_counterexample_that_fails_when_pasted(mine, start_cpgrl):
    status, out = typed(start_cpgrl, *CHECKS[1])
    assert status == 1, out
    failed, laws = out.count("  FAILED\n"), int(re.search(r"of (\d+) laws", out)[1])
    assert 0.35 <= failed / laws <= 0.65
    (code,) = re.findall(r"as a test:\n\n(.*?^    \)\n)", out, flags=re.DOTALL | re.MULTILINE)
    (mine / "test_pasted.py").write_text(code, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_pasted.py"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == pytest.ExitCode.TESTS_FAILED, run.stdout
    assert "LawBroken" in run.stdout
    assert "1 failed" in run.stdout


@pytest.mark.slow
def test_the_comparison_writes_the_files_that_are_named(tmp_path, start_cpgrl):
    (compare,) = [arguments for arguments in CPGRL if arguments[0] == "compare"]
    named = re.findall(r"`([^`]+)`", re.search(r"It writes (.*?)\(", README, flags=re.DOTALL)[1])
    assert len(named) == 3
    status, out = typed(start_cpgrl, *compare, "--solvers", "active-set,nnls", "--out", tmp_path)
    assert status == 0, out
    assert all((tmp_path / name).stat().st_size > 0 for name in named)
