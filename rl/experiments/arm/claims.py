"""What §4.2 of the paper says of Fig. 7, and what the figure does not say, against touches of the objects.

The margins were set before a full run was looked at, wide against the spread over seeds (docs/reproduction.md, §3),
but for b-avoids-star: its margins are the first ones, what they are held against is not. It asked for the mean of all
episodes from SETTLED on; since runs were looked at it asks for the thousand from there and for the last ones, each.
Rates are touches per 100 episodes, means over the runs; "early" and "late" as in TouchCurves.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..claims import Statements, Verdict
from .bound import greatest_average_r3
from .conditions import threshold_of_r3
from .curves import TouchCurves

STATEMENTS = Statements()
SETTLED = 1000  # "after about 1 × 10³ episodes"
SECTION, OURS = "§4.2", "not in the paper"
FIG7A, FIG7B, FIG7C = "§4.2, Fig. 7 (a)", "§4.2, Fig. 7 (b)", "§4.2, Fig. 7 (c)"
OTHERS = ("circle", "star", "triangle")  # than the square


@dataclass(frozen=True, eq=False)
class ArmEvidence:
    """Curves by condition; beside_star: of 100 episodes of (b)'s last policies from beside the star, the ends."""

    curves: Mapping[str, TouchCurves]
    beside_star: Mapping[str, float] = field(default_factory=dict)

    def early(self, condition: str) -> dict[str, float]:
        """Rates of the first episodes, by outcome."""
        return self.curves[condition].early().mean_rates()

    def late(self, condition: str) -> dict[str, float]:
        """Rates of the last episodes, by outcome."""
        return self.curves[condition].late().mean_rates()

    def opening(self, condition: str) -> dict[str, float]:
        """Rates of the first block."""
        learned = self.curves[condition]
        return learned.within(0, int(learned.episodes[0])).mean_rates()


@STATEMENTS.add(
    "a-learns-touching",
    "Since r¹ was a dense reward function, it was not hard to obtain touching behaviours",
    FIG7A,
    needs=("a",),
)
def a_learns_touching(evidence: ArmEvidence) -> Verdict:
    """(a): at most 5 of 100 late episodes end without a touch."""
    none = evidence.late("a")["none"]
    return none <= 5, {"episodes_without_touch": none, "at_most": 5}


@STATEMENTS.add(
    "b-touches-star-early",
    "At the early stage of learning, the robotic arm touched the aversive star object",
    FIG7B,
    needs=("b",),
)
def b_touches_star_early(evidence: ArmEvidence) -> Verdict:
    """(b): at least 8 of 100 among the first episodes."""
    star = evidence.early("b")["star"]
    return star >= 8, {"star_first": star, "at_least": 8}


@STATEMENTS.add(
    "b-avoids-star",
    "it learned to avoid the aversive star object after about 1 × 10³ episodes",
    FIG7B,
    needs=("b",),
)
def b_avoids_star(evidence: ArmEvidence) -> Verdict:
    """(b): in the thousand episodes from SETTLED on, and at last, at most 10 of 100, and 0.6 times the early rate."""
    first, last = evidence.early("b")["star"], evidence.late("b")["star"]
    after = evidence.curves["b"].within(SETTLED, 2 * SETTLED).mean_rates()["star"]
    measured = {"star_early": first, "star_after": after, "star_late": last}
    margins = {"after_episode": SETTLED, "at_most": 10, "times_early": 0.6}
    return max(after, last) <= min(10, 0.6 * first), {**measured, **margins}


@STATEMENTS.add(
    "b-touches-triangle",
    "The end-effector was initially located in the neighbourhood of the aversive star object, but the arm touched "
    "the triangular object",
    FIG7B,
    needs=("b",),
)
def b_touches_triangle(evidence: ArmEvidence) -> Verdict:
    """(b): at least 50 of 100 late episodes, and 60 of 100 from beside the star, end at the triangle."""
    late, beside = evidence.late("b"), evidence.beside_star
    measured = {**_prefix("late", late), "late_at_least": 50, **_prefix("beside_star", beside)}
    return late["triangle"] >= 50 and beside["triangle"] >= 60, {**measured, "beside_star_at_least": 60}


@STATEMENTS.add(
    "b-keeps-joint-angles",
    "Under G² = 0 the joint angles are kept within the bounds of r²",
    "§4.1, eq. of r²",
    needs=("b",),
)
def b_keeps_angles(evidence: ArmEvidence) -> Verdict:
    """(b): at most 1 % of the last steps leave the box of r²."""
    outside = float(evidence.curves["b"].late().outside().mean())
    return outside <= 0.01, {"share_outside": outside, "at_most": 0.01}


@STATEMENTS.add("c-square-increases", "the number of touches on the square objects increases", FIG7C, needs=("c",))
def c_square_increases(evidence: ArmEvidence) -> Verdict:
    """(c): at least 80 of 100 late episodes, and 1.1 times as many as in the first block."""
    first, last = evidence.opening("c")["square"], evidence.late("c")["square"]
    measured = {"square_first_block": first, "square_last": last, "at_least": 80, "times_first": 1.1}
    return last >= max(80, 1.1 * first), measured


@STATEMENTS.add("c-others-vanish", "while those on other objects are gradually reduced to zero", FIG7C, needs=("c",))
def c_others_vanish(evidence: ArmEvidence) -> Verdict:
    """(c): circle, star and triangle together at most 15 of 100 at last, and half of the first block's."""
    learned = evidence.curves["c"]
    first, last = (sum(rates[name] for name in OTHERS) for rates in (evidence.opening("c"), evidence.late("c")))
    few = sum(learned.per_hundred()[:, :, learned.outcomes.index(name)].mean(axis=0) for name in OTHERS) <= 15
    since = int(learned.episodes[few.argmax()]) if few.any() else 0
    measured = {"others_first_block": first, "others_last": last, "at_most": 15, "times_first": 0.5}
    return last <= min(15, 0.5 * first), {**measured, "first_so_few_at_episode": since}


@STATEMENTS.add(
    "threshold-matters",
    "G³ (printed G²) is a sensitive threshold that affects the resultant behaviours",
    SECTION,
    needs=("b", "c"),
)
def threshold_matters(evidence: ArmEvidence) -> Verdict:
    """(c) touches the square at least 50 times more of 100 than (b)."""
    with_zero, with_half = (evidence.late(name)["square"] for name in ("b", "c"))
    measured = {"square_b": with_zero, "square_c": with_half, "difference_at_least": 50}
    return with_half - with_zero >= 50, measured


@STATEMENTS.add(
    "a-winner-takes-all",
    "Without constraints a run ends with one object, not with all four, though r¹ is the same at each",
    OURS,
    needs=("a",),
)
def a_winner_takes_all(evidence: ArmEvidence) -> Verdict:
    """(a), mean over the runs: the most touched object has 50 of 100 late episodes, and twice the second's."""
    learned = evidence.curves["a"]
    rates = learned.late().rates()[:, :-1]
    second, first = (float(rate) for rate in np.sort(rates, axis=1)[:, -2:].mean(axis=0))
    winners = {name: int((rates.argmax(axis=1) == k).sum()) for k, name in enumerate(learned.arm.events)}
    measured = {"most_touched": first, "second": second, "at_least": 50, "times_second": 2}
    return first >= max(50, 2 * second), {**measured, **_prefix("runs_won_by", winners)}


@STATEMENTS.add(
    "c-threshold-out-of-reach",
    "G³ = 0.5 per step cannot be met, a touch taking several steps: in (c) the constraint stays active for ever",
    OURS,
    needs=("c",),
)
def c_out_of_reach(evidence: ArmEvidence) -> Verdict:
    """(c): the bound on ρ³, and what every run reaches, lie below G³."""
    threshold, bound = threshold_of_r3("c"), greatest_average_r3(evidence.curves["c"].arm)
    reached = float(max(learned.late().average_r3("step").max() for learned in evidence.curves.values()))
    measured = {"greatest_average": bound, "best_reached": reached, "threshold": threshold}
    return bound < threshold and reached < threshold, measured


@STATEMENTS.add(
    "c-episode-met-with-slack",
    "G³ = 0.5 is met with slack where ρ³ is averaged per episode",
    OURS,
    needs=("c-episode",),
)
def c_episode_met(evidence: ArmEvidence) -> Verdict:
    """(c) with ρ³ per episode: at least 0.6 at last, with slack over 0.5."""
    return _meets(evidence, "c-episode", "episode", 0.6)


@STATEMENTS.add("c-feasible-met", "G³ = 0.1 per step, which is feasible, is met", OURS, needs=("c-feasible",))
def c_feasible_met(evidence: ArmEvidence) -> Verdict:
    """(c) with G³ = 0.1: ρ³ at least 0.08 per step at last, the threshold but for a fifth."""
    return _meets(evidence, "c-feasible", "step", 0.08)


@STATEMENTS.add(
    "projection-not-shown-by-fig7",
    "Fig. 7 does not tell projection from gradient plus restoration: (c) without P ends the same",
    OURS,
    needs=("c", "c-no-projection"),
)
def projection_not_shown(evidence: ArmEvidence) -> Verdict:
    """(c) without P: every rate within 15 of 100 of (c)'s."""
    projected, whole = evidence.late("c"), evidence.late("c-no-projection")
    apart = max(abs(projected[name] - whole[name]) for name in projected)
    rates = {**_prefix("with_P", projected), **_prefix("without_P", whole)}
    return apart <= 15, {"largest_difference": apart, "at_most": 15, **rates}


def _meets(evidence: ArmEvidence, condition: str, unit: str, least: float) -> Verdict:
    average = float(evidence.curves[condition].late().average_r3(unit).mean())
    measured = {f"average_per_{unit}": average, "threshold": threshold_of_r3(condition), "at_least": least}
    return average >= least, {**measured, **_prefix("late", evidence.late(condition))}


def _prefix(prefix: str, values: Mapping[str, float]) -> dict[str, float]:
    return {f"{prefix}_{name}": value for name, value in values.items()}
