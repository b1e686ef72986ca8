"""README and docs/ tell the truth: examples run, links lead somewhere, tables and numbers are those of the code."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cpgrl_opt import FORMULATIONS, SOLVERS, Status
from cpgrl_opt.comparison.families import FAMILIES
from cpgrl_opt.exact import exact_answer
from cpgrl_opt.testing import LAWS, FunctionSolver
from cpgrl_opt.testing.examination import first_break
from cpgrl_opt.testing.laws_page import to_markdown
from rl.experiments.solver_cases import cases

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PATHS = {path.name: path for path in (*sorted(DOCS.glob("*.md")), ROOT / "README.md")}
PAGES = {name: path.read_text(encoding="utf-8") for name, path in PATHS.items()}
EXAMPLES = [
    (name, number, example)
    for name, page in PAGES.items()
    if name not in ("kinds.md", "jax.md", "torch.md")  # which tests of their own look at
    for number, example in enumerate(re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL))
]
README = PAGES["README.md"]
IN_README = [example for name, _, example in EXAMPLES if name == "README.md"]
LINKS = [(name, link) for name, page in PAGES.items() for link in re.findall(r"\]\(([^):]+)\)", page)]


@pytest.mark.parametrize(("name", "number", "example"), EXAMPLES, ids=[f"{each[0]}-{each[1]}" for each in EXAMPLES])
def test_an_example_runs_as_printed(name, number, example):
    exec(compile(example, f"{name}, example {number + 1}", "exec"), {})


@pytest.mark.parametrize(("name", "link"), LINKS)
def test_every_linked_file_exists(name, link):
    assert (PATHS[name].parent / link.split("#")[0]).exists() or link.startswith("#"), name


def test_every_page_has_its_place_in_the_site():
    listed = re.findall(r"^(\w+)$", PAGES["index.md"], flags=re.MULTILINE)
    assert sorted(f"{name}.md" for name in listed) == sorted(set(PAGES) - {"index.md", "README.md"})


def test_the_table_of_solvers_is_that_of_the_code():
    found = [line for line in PAGES["solvers.md"].splitlines() if re.match(r"\| `[a-z-]+` \|", line)]
    expected = [
        f"| `{name}` | {', '.join(cases(solver))} | {solver.guarantee} | {solver.source} |"
        for name, solver in SOLVERS.items()
    ]
    missing, gone = [row for row in expected if row not in found], [row for row in found if row not in expected]
    advice = ["docs/solvers.md should have these rows, in the order of SOLVERS:", *missing]
    advice += ["and no longer:", *gone] if gone else []
    assert found == expected, "\n".join(advice)


def test_the_laws_are_those_of_the_kit():
    command = "python -m cpgrl_opt.testing.laws_page > docs/laws.md"
    assert command in PAGES["laws.md"]
    assert PAGES["laws.md"] == to_markdown(), f"run {command}"


def test_the_limits_say_how_far_off_a_certified_answer_may_be():
    """1e-12 rad from opposing; where it said "an eighth" there were 38 %."""
    said = re.search(r"`active-set` is exact at 1e-10 rad, and up to (\d+) % off at 1e-12", PAGES["limits.md"])
    assert said
    problems = [FAMILIES["opposing-1e-12"].problem(k, 0) for k in range(60)]
    found = [(problem, exact_answer(problem), SOLVERS["active-set"].solve(problem)) for problem in problems]
    off = [
        np.linalg.norm(answer.value - exact.direction) / np.linalg.norm(problem.gradient)
        for problem, exact, answer in found
        if exact.feasible and answer.status == Status.OPTIMAL
    ]
    assert 0.25 * int(said[1]) / 100 < max(off) <= int(said[1]) / 100


def test_the_solver_that_is_said_to_be_right_is():
    """Two laws, for the whole of it is slow."""
    scope = {}
    source = next(example for name, _, example in EXAMPLES if name == "your_own_solver.md")
    exec(compile(source, "mine.py", "exec"), scope)
    for law in ("check_stationarity", "check_gradient_kept_when_feasible"):
        found = first_break(LAWS[law], scope["Doubtful"](), max_examples=20)
        assert (found.held, found.broken) == (20, 0)


def table(text, columns):
    """Headings and rows of the table whose headings begin with these."""
    (found,) = [part for part in text.split("\n\n") if part.startswith("| " + " | ".join(columns))]
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in found.splitlines()]
    return lines[0], lines[2:]


def test_the_formulations_are_those_of_the_code():
    _, rows = table(PAGES["formulations.md"], ["name"])
    assert [row[0].strip("`") for row in rows] == list(FORMULATIONS)


def test_the_numbers_are_those_that_the_benchmark_wrote():
    measured = ROOT / "benchmarks/results/violations_on_the_way.md"
    _, shown = table(PAGES["formulations.md"], ["task", "formulation"])
    titles, rows = table(measured.read_text(encoding="utf-8"), ["task", "method"])
    chosen = [titles.index(name) for name in ("task", "method", "by > 1 %, %", "largest, %", "return")]
    assert shown == [[row[k] for k in chosen] for row in rows]


def test_the_readme_is_short():
    assert len(README.split()) <= 700
    assert len(IN_README) == 3
    assert max(len(example.splitlines()) for example in IN_README) <= 16


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


def test_every_test_file_that_ci_lists_exists():
    listed = re.findall(r"tests/\S+\.py", (ROOT / ".ci/run").read_text(encoding="utf-8"))
    assert len(listed) > 10
    assert [name for name in listed if not (ROOT / name).exists()] == []


def test_the_readme_counts_the_laws():
    assert f"through {len(LAWS)} laws" in README


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A folder with the README's mine.py in it, which is where its command is typed."""
    source = IN_README[-1]
    assert "`mine.py`:\n\n```python\n" + source in README
    (tmp_path / "mine.py").write_text(source, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_function_of_the_readme_is_wrong_as_it_says(mine):
    """One law, for the whole of it is slow."""
    scope = {}
    exec(compile((mine / "mine.py").read_text(encoding="utf-8"), "mine.py", "exec"), scope)
    law = LAWS["check_gradient_kept_when_feasible"]
    assert first_break(law, FunctionSolver(scope["tangent"]), max_examples=20).broken == 1


@pytest.mark.slow
def test_it_breaks_half_of_the_laws_with_a_counterexample_that_fails_when_pasted(mine, start_cpgrl):
    (arguments,) = re.findall(r"\.venv/bin/cpgrl (check .*)$", README, flags=re.MULTILINE)
    command = start_cpgrl(*arguments.split())
    out, _ = command.communicate()
    assert command.returncode == 1, out
    failed, laws = out.count("  FAILED\n"), int(re.search(r"of (\d+) laws", out)[1])
    assert 0.35 <= failed / laws <= 0.65
    (code,) = re.findall(r"as a test:\n\n(.*?^    \)\n)", out, flags=re.DOTALL | re.MULTILINE)
    (mine / "test_pasted.py").write_text(code, encoding="utf-8")
    pytest_here = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_pasted.py"]
    run = subprocess.run(pytest_here, capture_output=True, text=True, check=False)
    assert run.returncode == pytest.ExitCode.TESTS_FAILED, run.stdout
    assert "LawError" in run.stdout
    assert "1 failed" in run.stdout
