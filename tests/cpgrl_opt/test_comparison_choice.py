"""The choice follows from the counts by the printed rule; pooled numbers weigh every problem alike."""

import math
from dataclasses import replace

import pytest

from cpgrl_opt.comparison.choice import choose
from cpgrl_opt.comparison.measurement import OUTCOMES, Cell, Measurement, cells_of
from cpgrl_opt.comparison.tallies import gains, tallies, tally


def cell(solver: str, success: int = 100, *, time_ratio: float = 1.0, family: str = "a", **others: int) -> Cell:
    counts = {name.replace("-", "_"): 0 for name in OUTCOMES} | {"success": success} | others
    return Cell(
        solver=solver, variant="prepared", family=family, problems=sum(counts.values()), noise=0, distance_median=None,
        distance_max=None, time_ratio=time_ratio, worst_median=None, **counts,
    )  # fmt: skip


def first(*cells: Cell) -> str:
    chosen = choose(cells).first
    assert chosen is not None
    return chosen.solver


def test_the_safer_of_two_near_each_other_is_chosen_though_slower() -> None:
    safe = cell("safe", 96, honest_failure=4, time_ratio=50.0)
    assert first(cell("fast", 99, silently_wrong=1), safe) == "safe"


@pytest.mark.parametrize("kind", ["silently_wrong", "false_infeasible", "missed_infeasible", "hang", "crash"])
def test_every_kind_of_unsafe_answer_counts(kind: str) -> None:
    assert first(cell("unsafe", 99, **{kind: 1}), cell("safe", 99, honest_failure=1, time_ratio=2.0)) == "safe"


def test_giving_up_most_of_the_time_is_not_safe_enough() -> None:
    assert first(cell("works", 99, silently_wrong=1), cell("idle", 0, honest_failure=100)) == "works"


def test_among_equals_the_fastest_is_chosen_and_the_next_is_the_check() -> None:
    choice = choose([cell("slow", time_ratio=3.0), cell("fast", time_ratio=0.5), cell("middle", time_ratio=1.0)])
    assert choice.first is not None
    assert choice.second is not None
    assert (choice.first.solver, choice.second.solver) == ("fast", "middle")


def test_a_raw_back_end_is_never_chosen() -> None:
    raw = replace(cell("raw", time_ratio=0.1), variant="raw")
    assert first(raw, cell("prepared", 50, silently_wrong=50)) == "prepared"
    assert choose([raw]).first is None


def test_a_specialist_is_named_where_it_solves_all_and_is_much_faster() -> None:
    cells = [
        cell("general"),
        cell("general", family="b"),
        *(cell(name, 0, unsupported=100) for name in ("special", "even", "wrong")),
        cell("special", family="b", time_ratio=0.4),
        cell("even", family="b", time_ratio=0.9),
        cell("wrong", 99, family="b", silently_wrong=1, time_ratio=0.4),
    ]
    choice = choose(cells)
    assert choice.first is not None
    assert choice.first.solver == "general"
    assert [(each.solver, each.families) for each in choice.specialists] == [("special", ("b",))]


def test_a_tally_weighs_problems_alike_and_leaves_unsupported_out_of_percentages() -> None:
    cells = [cell("s", 10, time_ratio=4.0), cell("s", 20, hang=10, unsupported=50, time_ratio=16.0, family="b")]
    pooled = tally("s", "prepared", cells)
    assert (pooled.problems, pooled.taken, pooled.unsafe) == (90, 40, 10)
    assert pooled.percent("success") == pytest.approx(75.0)
    assert pooled.time_ratio == pytest.approx(math.exp((10 * math.log(4.0) + 30 * math.log(16.0)) / 40))


def test_a_solver_of_few_problems_is_not_ranked_above_one_of_all() -> None:
    cells = [cell("general", 90, honest_failure=10), cell("special", 10, unsupported=90)]
    assert [each.solver for each in tallies(cells, "prepared")] == ["general", "special"]


def test_the_gain_compares_the_same_problems() -> None:
    def one(variant: str, problem: int, outcome: str) -> Measurement:
        return Measurement(
            solver="s", variant=variant, family="a", problem=problem, n=2, m=1, status="", outcome=outcome, worst=0.0,
            distance=None, seconds=1.0, ratio=1.0, limit=1.0, noise=False,
        )  # fmt: skip

    prepared = [one("prepared", 0, "success"), one("prepared", 1, "success"), one("prepared", 2, "hang")]
    raw = [one("raw", 0, "success"), one("raw", 1, "silently-wrong"), one("raw", 3, "crash")]
    (gain,) = gains(prepared + raw)
    assert (gain.raw.problems, gain.prepared.problems) == (2, 2)
    assert gain.points == pytest.approx(50.0)
    assert (gain.raw.unsafe, gain.prepared.unsafe) == (1, 0)
    assert gain.prepared == tally("s", "prepared", cells_of(prepared[:2]))
