"""The README tells the truth: its examples run, its commands are the ones CI runs, and it takes two minutes to read."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from cpgrl_opt.testing import LAWS, FunctionSolver
from cpgrl_opt.testing.examination import first_break

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


def test_it_is_short():
    assert len(README.split()) <= 700
    assert len(EXAMPLES) == 3
    assert max(len(example.splitlines()) for example in EXAMPLES) <= 16


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


def test_it_counts_the_laws():
    assert f"through {len(LAWS)} laws" in README


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A folder with the README's mine.py in it, which is where its command is typed."""
    source = EXAMPLES[-1]
    assert "`mine.py`:\n\n```python\n" + source in README
    (tmp_path / "mine.py").write_text(source, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_function_is_wrong_as_it_says(mine):
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
    assert "LawBroken" in run.stdout
    assert "1 failed" in run.stdout
