"""The measurements as a table: what is counted, profiles (Dolan & Moré 2002) and the choice, by its printed rule."""

import math
import random
from pathlib import Path

import numpy as np
import pytest

from cpgrl_opt.comparison import load
from cpgrl_opt.comparison.choice import choose
from cpgrl_opt.comparison.measurement import OUTCOMES, Measurement, write_measurements
from cpgrl_opt.comparison.table import as_table, count, count_cells, pandas, profiles, taken_by_both

from .comparisons import measurement


def one(solver: str, problem: int, outcome: str = "success", ratio: float = 1.0, **others: object) -> Measurement:
    told = {"family": "a", "limit": 1e3, "status": "", "seconds": ratio} | others
    return measurement(solver=solver, problem=problem, outcome=outcome, ratio=ratio, **told)


def several(solver: str, family: str = "a", ratio: float = 1.0, **counts: int) -> list[Measurement]:
    """So many of each outcome, underscores for hyphens."""
    outcomes = [name.replace("_", "-") for name, number in counts.items() for _ in range(number)]
    return [one(solver, k, outcome, ratio, family=family, limit=ratio) for k, outcome in enumerate(outcomes)]


def chosen(*groups: list[Measurement]) -> str:
    return choose(as_table([each for group in groups for each in group])).first


def test_the_table_of_a_folder_is_that_of_the_measurements(tmp_path: Path) -> None:
    told = [
        one("s", 0, distance=1e-17, family="007"),
        one("t", 1, "hang", 1 / 3, noise=True, variant="raw", family="nan"),
    ]
    write_measurements(tmp_path / "measurements.csv", told)
    table = load(tmp_path)
    assert list(table.columns) == list(as_table(told).columns)
    for column in table.columns:
        np.testing.assert_array_equal(table[column], as_table(told)[column])
    (tmp_path / "measurements.csv").write_text("solver,distance\ns,1\n", encoding="utf-8")
    with pytest.raises(ValueError, match="should have the columns"):
        load(tmp_path)


def test_without_pandas_it_says_what_to_type(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(ImportError, match=r"pip install 'cpgrl-opt\[report\]'"):
        pandas()


def test_counts_are_those_of_the_cells_and_what_is_not_taken_enters_no_mean() -> None:
    rng = random.Random(0)
    told = [
        one(solver, k, rng.choice(OUTCOMES), rng.uniform(0.5, 9.0), family=family, distance=rng.choice([None, 0.25]))
        for solver in "st" for family in "ab" for k in range(40)
    ]  # fmt: skip
    found = count(as_table(told), ["solver", "family"], ill_posed=["b"])
    for cell in count_cells(as_table(told)).itertuples():
        own = found.loc[cell.solver, cell.family]
        assert own["taken"] == cell.problems - cell.unsupported
        ill, well = ("ill_posed", "distance") if cell.family == "b" else ("distance", "ill_posed")
        assert own[ill] == cell.distance_max
        assert math.isnan(own[well])
    pooled = count(
        as_table(several("s", success=10, ratio=4.0) + several("s", "b", hang=30, unsupported=50, ratio=16.0)),
        ["solver"],
    )
    assert pooled.loc["s", "time"] == pytest.approx(math.exp((10 * math.log(4.0) + 30 * math.log(16.0)) / 40))
    assert (pooled.loc["s", "taken"], pooled.loc["s", "unsafe"]) == (40, 30)


def test_a_gain_compares_the_same_problems() -> None:
    told = [one("s", 0), one("s", 1), one("s", 2, "hang")]
    told += [
        one("s", 0, variant="raw"),
        one("s", 1, "silently-wrong", variant="raw"),
        one("s", 3, "crash", variant="raw"),
    ]
    both = taken_by_both(as_table(told))
    assert set(both["problem"]) == {0, 1}
    assert len(both) == 4


def test_profiles_by_hand() -> None:
    found = profiles(as_table([
        one("a", 0, ratio=1.0), one("a", 1, ratio=6.0), one("a", 2, "hang", 0.1),
        one("b", 0, ratio=4.0), one("b", 1, ratio=2.0), one("b", 2, ratio=5.0),
    ]))  # fmt: skip
    np.testing.assert_allclose(found["a"], [[1.0, 3.0], [1 / 3, 2 / 3]])
    np.testing.assert_allclose(found["b"], [[1.0, 1.0, 4.0], [1 / 3, 2 / 3, 1.0]])


def test_profiles_rise_to_the_share_of_successes_and_someone_is_fastest() -> None:
    rng = random.Random(0)
    told = [
        one(solver, k, rng.choice(("success", "success", "hang", "silently-wrong")), rng.lognormvariate(0, 1))
        for solver in "abcd" for k in range(30)
    ]  # fmt: skip
    found = profiles(as_table(told))
    for solver, (factors, shares) in found.items():
        assert shares[-1] == pytest.approx(sum(e.outcome == "success" for e in told if e.solver == solver) / 30)
        assert (np.diff(factors) >= 0).all()
        assert factors[0] >= 1.0
    solved = {each.problem for each in told if each.outcome == "success"}
    assert sum((factors == 1.0).sum() for factors, _ in found.values()) == len(solved)


# the outcomes of the choice, and of the other, which is the faster one
CHOICES = {
    "the safer of two near each other": ({"success": 96, "honest_failure": 4}, {"success": 99, "silently_wrong": 1}),
    "what never hangs": ({"success": 99, "honest_failure": 1}, {"success": 99, "hang": 1}),
    "not what mostly gives up": ({"success": 99, "silently_wrong": 1}, {"honest_failure": 100}),
}


@pytest.mark.parametrize("name", CHOICES)
def test_success_to_a_margin_and_safety_come_before_time(name: str) -> None:
    right, other = CHOICES[name]
    assert chosen(several("other", **other), several("right", ratio=50.0, **right)) == "right"


def test_among_equals_the_fastest_is_chosen_the_next_is_the_check_and_raw_ones_never() -> None:
    told = [
        each
        for name, ratio in (("slow", 3.0), ("fast", 0.5), ("middle", 1.0))
        for each in several(name, success=9, ratio=ratio)
    ]
    told += [one("raw", k, ratio=0.1, variant="raw") for k in range(9)]
    choice = choose(as_table(told))
    assert (choice.first, choice.second) == ("fast", "middle")
    assert choose(as_table([each for each in told if each.solver == "raw"])).first == ""


def test_a_specialist_is_named_where_it_solves_all_and_is_much_faster() -> None:
    told = several("general", success=9) + several("general", "b", success=9)
    for name, ratio, outcomes in (
        ("special", 0.4, {"success": 9}),
        ("even", 0.9, {"success": 9}),
        ("wrong", 0.4, {"success": 8, "silently_wrong": 1}),
    ):
        told += several(name, unsupported=9) + several(name, "b", ratio, **outcomes)
    choice = choose(as_table(told))
    assert choice.first == "general"
    assert [(each.solver, each.families) for each in choice.specialists] == [("special", ["b"])]
