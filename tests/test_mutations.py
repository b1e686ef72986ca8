"""The mutation run, tiny: what it would change, and that it tells what tests notice from what they do not."""

import numpy as np
import pytest

SOURCE = '''"""1 < 2."""
from cpgrl_opt import nothing

LIMIT: "int | 3" = 1e-6


@decorated(4)
def area(a, b, /, sign=-2.0):
    if a < b and not sign:
        raise ValueError(f"{a + b}")
    return max(a @ b.T, np.any(b)) * ([a] if True else b)[0]
'''
CHANGED = [
    *('LIMIT: "int | 3" = 0.01', "sign=(2.0)", "sign=-3.0", "if (a < b or not sign):", "if (a >= b) and not sign:"),
    *("if a < b and (sign):", "return (max(a @ b.T, np.any(b)) / ([a] if True else b)[0])", "return min(a @ b.T,"),
    *("max((b.T @ a),", "max(a @ b,", "np.all(b)", "((b if True else [a]))[0]", "[a] if False else b", "else b)[1]"),
]


@pytest.fixture
def benchmark(load_benchmark):
    return load_benchmark("mutations")


def test_every_expression_that_runs_is_changed_in_every_way(benchmark):
    found = [each.source for each in benchmark.mutate("area.py", SOURCE)]
    assert len(found) == len(CHANGED)
    for changed in CHANGED:
        assert sum(changed in source for source in found) == 1, changed
    lengths = [sum(one != two for one, two in zip(each.split("\n"), SOURCE.split("\n"), strict=True)) for each in found]
    assert lengths == [1] * len(found)


def test_tests_of_a_module_are_those_that_import_it_first_however_names_are_passed_on(benchmark, tmp_path):
    for file, source in {
        "cpgrl_opt/__init__.py": "from .step import Step\n",
        "cpgrl_opt/step.py": "class Step: ...\n",
        "rl/learners.py": "from cpgrl_opt import Step\n",
        "tests/test_learners.py": "from rl import learners\n",
        "tests/test_a.py": "from cpgrl_opt import Step\nimport_module('rl.learners')\n",
        "tests/test_step.py": "def test():\n    from cpgrl_opt import Step\n",
        "tests/test_nothing.py": "",
    }.items():
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(source, encoding="utf-8")
    expected = [f"tests/test_{name}.py" for name in ("step", "a", "learners", "nothing")]
    assert benchmark.Imports(tmp_path).nearest("cpgrl_opt/step.py") == expected


@pytest.fixture
def project(tmp_path):
    for name in ("cpgrl_opt", "tests"):
        (tmp_path / name).mkdir()
    (tmp_path / "pyproject.toml").touch()
    (tmp_path / "cpgrl_opt/__init__.py").touch()
    source = "def half(x):\n    while x < 0:\n        x = 0\n    return x / 2.0\n"
    (tmp_path / "cpgrl_opt/scaling.py").write_text(source, encoding="utf-8")
    test = "from cpgrl_opt.scaling import half\n\n\ndef test_half():\n    assert half(2.0) == 1.0 >= half(-1.0)\n"
    wrong = "\n\ndef test_wrong_without_a_mutation():\n    assert False\n"
    (tmp_path / "tests/test_problem.py").write_text(test + wrong, encoding="utf-8")
    return tmp_path


def test_it_says_which_mutations_the_tests_notice(benchmark, project):
    drawn = benchmark.draw(project, ["cpgrl_opt/scaling.py"], 100, np.random.default_rng(0))
    lines = {"x = 1": "survived", "return (x * 2.0)": "killed"}
    some = [each for each in drawn if any(line in each.source for line in lines)]
    unclear = benchmark.Mutation("cpgrl_opt/scaling.py", 1, "constant", "a line that is no Python\n")
    rows = benchmark.run(project, [*some, unclear], 10.0)
    assert {row.diff.splitlines()[-1].strip("+ "): row.outcome for row in rows[:-1]} == lines
    assert rows[-1].outcome == "unclear"
    page = "\n".join(benchmark.parts(rows, "of a run"))
    assert "1 of 2 noticed, 0 of them by the time that they take; 1 survived; 1 unclear. of a run." in page
    assert "```diff\n-        x = 0\n+        x = 1\n```" in page


def test_tests_that_take_too_long_are_ended(benchmark, project):
    (project / "cpgrl_opt/scaling.py").write_text("while True:\n    pass\n")
    assert benchmark.run_tests(project, ["tests"], limit=0.2) is None
