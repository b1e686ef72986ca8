"""The README tells the truth: its examples run, its table is that of SOLVERS, its commands are the ones CI runs."""

import re
from pathlib import Path

import pytest

from cpgrl_opt import SOLVERS
from rl.experiments.solver_cases import cases

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


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
    assert found == expected


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


@pytest.mark.parametrize("name", re.findall(r"\]\(([^):]+)\)", README))
def test_every_linked_file_exists(name):
    assert (ROOT / name.split("#")[0]).exists()
