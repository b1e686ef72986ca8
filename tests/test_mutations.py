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


def test_every_expression_that_runs_is_changed_in_every_way(load_benchmark):
    found = [each.source for each in load_benchmark("mutations").mutations("area.py", SOURCE)]
    assert len(found) == len(CHANGED)
    for changed in CHANGED:
        assert sum(changed in source for source in found) == 1, changed
    lengths = [sum(one != two for one, two in zip(each.split("\n"), SOURCE.split("\n"), strict=True)) for each in found]
    assert lengths == [1] * len(found)


def test_a_seed_draws_the_same_mutations_of_the_core_and_every_module_has_tests(load_benchmark):
    benchmark = load_benchmark("mutations")
    tests = benchmark.tests_of(benchmark.ROOT, benchmark.TESTS)
    assert {"cpgrl_opt/step.py", "cpgrl_opt/solvers/compiled/_direct.py", "cpgrl_opt/vectors/_trees.py"} <= tests.keys()
    assert all(tests.values())
    one, two = (benchmark.draw(benchmark.ROOT, list(tests), 20, np.random.default_rng(3)) for _ in range(2))
    assert one == two
    assert len({(each.file, each.source) for each in one}) == 20


@pytest.fixture
def project(tmp_path):
    for name in ("cpgrl_opt", "tests/cpgrl_opt"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "pyproject.toml").touch()
    (tmp_path / "cpgrl_opt/__init__.py").touch()
    (tmp_path / "cpgrl_opt/scaling.py").write_text(
        "def half(x):\n    while x < 0:\n        x = 0\n    return x / 2.0\n"
    )
    test = "from cpgrl_opt.scaling import half\n\n\ndef test_half():\n    assert half(2.0) == 1.0 >= half(-1.0)\n"
    (tmp_path / "tests/cpgrl_opt/test_problem.py").write_text(test)
    return tmp_path


def test_it_says_which_mutations_the_tests_notice(load_benchmark, project):
    benchmark = load_benchmark("mutations")
    tests = benchmark.tests_of(project, benchmark.TESTS)
    drawn = benchmark.draw(project, list(tests), 100, np.random.default_rng(0))
    two = [each for each in drawn if (each.line, each.kind) in ((3, "constant"), (4, "operator"))]
    rows = benchmark.run(project, two, tests)
    outcomes = {row.diff.splitlines()[-1].strip("+ "): row.outcome for row in rows}
    assert outcomes == {"x = 1": "survived", "return (x * 2.0)": "killed"}
    page = benchmark.page(rows, "the command", "1234567")
    assert "`the command`: 1 of 2 noticed, 0 of them by the time" in page
    assert "```diff\n-        x = 0\n+        x = 1\n```" in page


def test_tests_that_take_too_long_are_ended(load_benchmark, project):
    (project / "cpgrl_opt/scaling.py").write_text("while True:\n    pass\n")
    assert load_benchmark("mutations").run_tests(project, ["tests"], limit=0.2) == (None, "")


def test_tests_that_fail_without_a_mutation_are_told(load_benchmark, project):
    benchmark = load_benchmark("mutations")
    (project / "tests/cpgrl_opt/test_problem.py").write_text("def test_wrong():\n    assert False\n")
    tests = benchmark.tests_of(project, benchmark.TESTS)
    with pytest.raises(ValueError, match="should pass without a mutation"):
        benchmark.run(project, benchmark.draw(project, list(tests), 1, np.random.default_rng(0)), tests)
