"""The verdict counts honestly, repeats itself, writes nothing into the user's folder, and can be read."""

import random
import subprocess
import sys
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status
from cpgrl_opt.published import PUBLISHED
from cpgrl_opt.solvers import tolerance_of
from cpgrl_opt.testing import (
    LAWS,
    LawError,
    Outcome,
    check_direction_solver,
    check_idempotence,
    check_scaling,
    check_stationarity,
    domain,
    parametrize_with_checks,
    supported_cases,
)
from cpgrl_opt.testing.counterexample import counterexample_code
from cpgrl_opt.testing.strategies import ALL_CASES

from .bad_solvers import Faulty, claimed, not_a_number, unit_length

PROBLEM = DirectionProblem([1.0, 1.0], [[-1.0, 0.0]])
CORRECT = SOLVERS["active-set"]


@dataclass(frozen=True)
class UnitLength:
    """A known-bad solver that declares nothing."""

    def solve(self, problem):
        return unit_length(problem, CORRECT.solve(problem))


@pytest.fixture(scope="module")
def verdict():
    return check_direction_solver(
        UnitLength(),
        checks=["check_stationarity", "check_scaling", "check_silence", "check_batch_is_loop"],
        expected_failures={"check_scaling": "its length is 1 by design", "check_silence": "might print"},
        max_examples=20,
    )


def test_every_law_is_a_check_of_the_package_and_states_itself():
    import cpgrl_opt.testing as kit

    assert len(LAWS) == 33
    for name, law in LAWS.items():
        assert getattr(kit, name) is law.check
        assert name in kit.__all__
        assert len(law.statement) > 20
        assert "Source:" in law.check.__doc__, name


def test_declared_failures_are_excused_and_others_are_not_and_counts_add_up(verdict):
    assert not verdict.passed
    assert verdict.tolerance == 1e-6
    assert supported_cases(UnitLength()) == list(ALL_CASES)
    words = {result.check: result.word for result in verdict.results}
    assert words == {
        "check_stationarity": "FAILED",
        "check_scaling": "failed as expected",
        "check_silence": "held, though expected to fail",
        "check_batch_is_loop": "unsupported",
    }
    broken, declared = verdict["check_stationarity"], verdict["check_scaling"]
    assert verdict.failures == (broken,)
    assert broken.run + broken.skipped == 20
    assert 0 < broken.failed <= broken.run - broken.declined
    assert (broken.expected, declared.failed) == (0, 0)
    assert declared.expected > 0
    with pytest.raises(LawError, match=r"check_stationarity[\s\S]*should be at most 1e-06[\s\S]*DirectionProblem\("):
        verdict.raise_for_failures()
    declared.raise_for_failure()


def test_the_markdown_has_a_row_for_every_check_and_the_code(verdict):
    text = verdict.to_markdown()
    assert text.startswith("# Verdict on UnitLength()\n\nUnitLength() does not pass: of 4 laws 1 held")
    for result in verdict.results:
        assert f"| {result.check} |" in text
    assert "failed as expected: its length is 1 by design" in text
    assert "```python\nfrom cpgrl_opt import DirectionProblem\n" in text
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert {row.replace("\\|", "").count("|") for row in rows} == {9}


def test_the_same_seed_gives_the_same_verdict_and_another_seed_other_problems(verdict):
    def drawn(seed):
        seen = []
        spy = SimpleNamespace(solve=lambda problem: seen.append(problem) or CORRECT.solve(problem))
        check_direction_solver(spy, checks=["check_stationarity"], max_examples=5, seed=seed)
        return [problem.gradient.tobytes() for problem in seen]

    assert drawn(3) != drawn(4)
    again = check_direction_solver(UnitLength(), checks=["check_stationarity"], max_examples=20)
    assert again["check_stationarity"] == verdict["check_stationarity"]


def test_a_solver_that_draws_from_the_global_generators_gets_the_same_verdict_each_time(monkeypatch):
    """Kept problems and streamed ones, after other draws of the caller's; whose generators stay as they are."""

    def giving_up(_, answer):
        gives_up = max(np.random.random(), random.random()) < 0.8  # noqa: NPY002 - what is tested
        return replace(answer, status=Status.ITERATION_LIMIT) if gives_up else answer

    def declined():
        checks = ["check_stationarity", "check_answers_repeat"]
        verdict = check_direction_solver(Faulty(giving_up), checks=checks, max_examples=20)
        return [(result.run, result.declined, result.failed) for result in verdict.results]

    seen = set()
    for number, kept in ((1, 20_000), (2, 0)):
        np.random.seed(number)  # noqa: NPY002
        random.seed(number)
        monkeypatch.setattr("cpgrl_opt.testing.examination._MOST_KEPT", kept)
        seen.add((*declined(), np.random.random() == np.random.RandomState(number).random()))  # noqa: NPY002
        assert random.random() == random.Random(number).random()
    assert len(seen) == 1
    assert seen.pop()[-1], "NumPy's global generator is the caller's"


def is_example(problem):
    """Whether it is one of those by which the kit finds out what a solver takes."""
    return id(problem) in _identities()


@cache
def _identities():
    return {id(each) for each in domain._examples(domain._usual())}


def test_a_check_that_ran_on_nothing_is_not_passed_and_not_excused(monkeypatch):
    """`supports` takes an example of each case but none of the problems."""
    monkeypatch.setattr("cpgrl_opt.testing.examination._MOST_REFUSED", 20)
    choosy = SimpleNamespace(solve=CORRECT.solve, supports=is_example)
    check, excuse = "check_stationarity", {"check_stationarity": "is bound to break"}
    for expected in ({}, excuse):
        verdict = check_direction_solver(choosy, checks=[check], expected_failures=expected, max_examples=5)
        assert (verdict.passed, verdict[check].word) == (False, "FAILED")
        assert (verdict[check].run, verdict[check].skipped) == (0, 5)
        assert "no problem was run" in verdict[check].problem
    with pytest.raises((LawError, pytest.xfail.Exception), match="no problem was run"):
        items_of({"mine": choosy}, expected_failures={"mine": excuse})["mine-stationarity"](choosy)


def items_of(solvers, max_examples=5, **more):
    """The items that pytest is handed, by id: each calls its check."""
    items = parametrize_with_checks(solvers, max_examples=max_examples, **more).mark.args[1]
    return {item.id: item.values[1] for item in items}


def test_of_a_solver_that_takes_nothing_verdict_and_items_fail():
    nothing = SimpleNamespace(solve=None, supports=lambda _: False)
    verdict = check_direction_solver(nothing, checks=["check_stationarity"])
    assert not verdict.passed
    assert "0 held, 1 unsupported; no problem was run: let `supports` take some" in verdict.summary
    with pytest.raises(LawError, match="no problem was run"):
        verdict.raise_for_failures()
    assert not check_direction_solver(CORRECT, checks=[]).passed
    with pytest.raises(LawError, match="should take some of the laws' problems"):
        items_of({"idle": nothing})["idle-stationarity"](nothing)


def test_after_three_losses_the_rest_is_not_run(monkeypatch):
    lost = iter(range(20))
    monkeypatch.setattr("cpgrl_opt.testing.verdict.losses_of", lambda _: next(lost))
    verdict = check_direction_solver(CORRECT, checks=list(LAWS)[:5], max_examples=1)
    assert ["not run" in result.problem for result in verdict.results] == [False, False, False, True, True]
    assert not verdict.passed


@pytest.mark.parametrize("problem_of_the_law", [False, True], ids=["on an example", "on a problem of the law"])
@pytest.mark.parametrize("reason", ["", "is unfinished"])
def test_a_supports_that_raises_is_a_failure_that_says_so_and_counts(problem_of_the_law, reason):
    def hesitant(problem):
        if problem_of_the_law and is_example(problem):
            return True
        raise KeyError("no such case")

    solver = SimpleNamespace(solve=CORRECT.solve, supports=hesitant)
    checks = ["check_stationarity", "check_non_finite_is_refused", "check_permutation"]
    expected = dict.fromkeys(checks, reason) if reason else {}
    verdict = check_direction_solver(solver, checks=checks, expected_failures=expected, max_examples=6)
    assert verdict.passed == bool(reason)
    for result in verdict.results:
        words = "supports should say True or False of a valid problem; it raised KeyError: 'no such case'"
        assert words in result.problem
        assert (result.expected if reason else result.failed) == result.run > 0
        assert bool(result.counterexample) == problem_of_the_law


@pytest.mark.parametrize("tolerance", [2e-3, 0.0, float("nan"), "small"])
def test_a_declared_tolerance_by_which_anything_is_an_optimum_is_refused(tolerance):
    """d = g with μ = 0 is within 10 of every optimum."""
    lenient = SimpleNamespace(solve=lambda p: claimed(p.gradient, np.zeros(p.m)), tolerance=tolerance)
    message = rf"tolerance should be a number in \(0, 0\.001\]; found {tolerance!r}"
    with pytest.raises(ValueError, match=message):
        check_direction_solver(lenient, max_examples=1)
    with pytest.raises(ValueError, match=message):
        items_of({"lenient": lenient})["lenient-stationarity"](lenient)


def test_the_largest_tolerance_may_be_declared_and_nothing_shipped_declares_more():
    assert tolerance_of(SimpleNamespace(solve=None, tolerance=1e-3)) == 1e-3
    assert {name: tolerance_of(each) for name, each in {**SOLVERS, **PUBLISHED}.items()}


def test_wrong_names_are_answered_with_the_right_ones():
    for arguments in ({"checks": ["stationarity"]}, {"expected_failures": {"stationarity": "a typing error"}}):
        with pytest.raises(ValueError, match="check should be one of check_claims_are_certified, check_stationarity"):
            check_direction_solver(UnitLength(), **arguments)
    with pytest.raises(ValueError, match="solver in expected_failures should be one of mine; found 'yours'"):
        parametrize_with_checks({"mine": UnitLength()}, expected_failures={"yours": {}})


def test_checks_are_plain_functions():
    assert check_stationarity(CORRECT, PROBLEM) == Outcome.HELD
    assert check_idempotence(SOLVERS["rosen"], PROBLEM) == Outcome.SKIPPED
    declining = SimpleNamespace(solve=lambda _: Direction(np.zeros(2), np.zeros(1), Status.NUMERICAL_ERROR))
    assert check_stationarity(declining, PROBLEM) == Outcome.DECLINED
    with pytest.raises(LawError, match="The direction has a length of its own"):
        check_scaling(UnitLength(), DirectionProblem([0.0, 1.0], [[1.0, 0.0]]), factor=2.0)


def answered(status, multipliers=(1.0,), value=(0.0, 1.0)):
    return SimpleNamespace(value=list(value), multipliers=list(multipliers), status=status)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, "should return an object with value"),
        (answered(0, [0.0], [0.0]), r"should have shapes \(2,\) and \(1,\)"),
        (answered("solved"), "status, a cpgrl_opt.Status"),
        (not_a_number(PROBLEM, None), "should be finite"),
    ],
)
def test_malformed_answers_are_told_apart(answer, message):
    with pytest.raises(LawError, match=message):
        check_stationarity(SimpleNamespace(solve=lambda _: answer), PROBLEM)


@pytest.mark.parametrize("status", [0, "optimal", Status.OPTIMAL])
def test_a_status_may_be_a_number_or_a_name(status):
    assert check_stationarity(SimpleNamespace(solve=lambda _: answered(status)), PROBLEM) == Outcome.HELD


def test_there_is_an_item_for_each_solver_and_law_that_fails_skips_or_xfails():
    mine, excused = UnitLength(), {"mine": {"check_scaling": "is short"}}
    items = items_of({"mine": mine, "yours": CORRECT}, max_examples=8, expected_failures=excused)
    assert len(items) == 2 * len(LAWS)
    for name, end in (
        ("mine-stationarity", LawError),
        ("mine-batch_is_loop", pytest.skip.Exception),
        ("mine-scaling", pytest.xfail.Exception),
    ):
        with pytest.raises(end):
            items[name](mine)
    assert items["yours-silence"](CORRECT).passed


def test_a_counterexample_writes_metric_and_radius_out():
    problem = DirectionProblem([1.0, 2.0], [[1.0, 0.0]], metric=[[2.0, 1.0], [1.0, 2.0]], radius=0.5)
    code = counterexample_code(LAWS["check_stationarity"], None, {"problem": problem}, imports=(), spelled="SOLVER")
    space = {"SOLVER": CORRECT}
    exec(code, space)  # it is the code that is pasted
    space["test_stationarity_holds_here"]()
    assert "radius=0.5" in code


def test_nothing_is_written_into_the_folder_of_the_user(tmp_path):
    code = (
        "from cpgrl_opt import SOLVERS; from cpgrl_opt.testing import check_direction_solver; "
        "print(check_direction_solver(SOLVERS['nnls'], checks=['check_stationarity'], max_examples=3).summary)"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert run.stdout.strip().endswith("passes: of 1 laws 1 held.")
    assert run.stderr == ""
    assert list(tmp_path.iterdir()) == []


def test_without_hypothesis_the_error_says_what_to_type():
    code = (
        "import sys; sys.modules['hypothesis'] = None\n"
        "try:\n    import cpgrl_opt.testing\n"
        "except ImportError as error:\n    print(error)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "type: pip install 'cpgrl-opt[testing]'" in run.stdout
