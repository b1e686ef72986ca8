"""What §4.2 of the paper says of Fig. 7, and what the figure does not say, against touches of the objects.

The margins were set before a full run was looked at, wide against the spread over seeds (docs/reproduction.md, §3),
but for b-avoids-star: its margins are the first ones, what they are held against is not. It asked for the mean of all
episodes from SETTLED on; since runs were looked at it asks for the thousand from there and for the last ones, each.
Rates are touches per 100 episodes, means over the runs; "early" and "late" as in TouchCurves.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from .claims import Claim
from .two_link_arm import CONDITIONS
from .two_link_arm_bound import greatest_average_r3
from .two_link_arm_curves import TouchCurves

SETTLED = 1000  # "after about 1 × 10³ episodes"
OURS = "not in the paper"
_OTHERS = ("circle", "star", "triangle")  # than the square


@dataclass(frozen=True, eq=False)
class ArmEvidence:
    """Curves by condition; beside_star: of 100 episodes of (b)'s last policies from beside the star, the ends."""

    curves: Mapping[str, TouchCurves]
    beside_star: Mapping[str, float] = field(default_factory=dict)


def two_link_arm_claims(evidence: ArmEvidence) -> list[Claim]:
    """Those whose conditions were trained, in the paper's order, then ours."""
    return [judge(evidence) for needs, judge in _CLAIMS if set(needs) <= set(evidence.curves)]


def a_learns_touching(evidence: ArmEvidence) -> Claim:
    """(a): at most 5 of 100 late episodes end without a touch."""
    none = _mean(evidence.curves["a"].late(), "none")
    return Claim(
        "a-learns-touching",
        "Since r¹ was a dense reward function, it was not hard to obtain touching behaviours",
        "§4.2, Fig. 7 (a)",
        {"episodes_without_touch": none, "at_most": 5},
        f"{none:.1f} of 100 late episodes end without a touch; ≤ 5 asked",
        none <= 5,
    )


def b_touches_star_early(evidence: ArmEvidence) -> Claim:
    """(b): at least 8 of 100 among the first episodes."""
    star = _mean(evidence.curves["b"].early(), "star")
    return Claim(
        "b-touches-star-early",
        "At the early stage of learning, the robotic arm touched the aversive star object",
        "§4.2, Fig. 7 (b)",
        {"star_first": star, "at_least": 8},
        f"{star:.1f} of 100 early episodes end at the star; ≥ 8 asked",
        star >= 8,
    )


def b_avoids_star(evidence: ArmEvidence) -> Claim:
    """(b): in the thousand episodes from SETTLED on, and at last, at most 10 of 100, and 0.6 times the early rate."""
    learned = evidence.curves["b"]
    first, last = _mean(learned.early(), "star"), _mean(learned.late(), "star")
    after = _mean(learned.within(SETTLED, 2 * SETTLED), "star")
    return Claim(
        "b-avoids-star",
        "it learned to avoid the aversive star object after about 1 × 10³ episodes",
        "§4.2, Fig. 7 (b)",
        {"star_early": first, "star_after": after, "star_late": last, "after_episode": SETTLED,
         "at_most": 10, "times_early": 0.6},
        f"{first:.1f} of 100 early episodes end at the star, {after:.1f} of those from {SETTLED} to {2 * SETTLED}, "
        f"{last:.1f} of the late ones; ≤ 10 and ≤ 0.6 times the early ones asked",
        max(after, last) <= min(10, 0.6 * first),
    )  # fmt: skip


def b_touches_triangle(evidence: ArmEvidence) -> Claim:
    """(b): at least 50 of 100 late episodes, and 60 of 100 from beside the star, end at the triangle."""
    late, beside = evidence.curves["b"].late(), evidence.beside_star
    triangle = _mean(late, "triangle")
    return Claim(
        "b-touches-triangle",
        "The end-effector was initially located in the neighbourhood of the aversive star object, but the arm touched "
        "the triangular object",
        "§4.2, Fig. 7 (b)",
        {**_rates("late", late), "late_at_least": 50,
         **{f"beside_star_{name}": rate for name, rate in beside.items()}, "beside_star_at_least": 60},
        f"from all around the star {beside['triangle']:.1f} of 100 episodes end at the triangle (≥ 60 asked), "
        f"{beside['star']:.1f} at the star. Late episodes: {_told(late)}; triangle ≥ 50 asked",
        triangle >= 50 and beside["triangle"] >= 60,
    )  # fmt: skip


def b_keeps_angles(evidence: ArmEvidence) -> Claim:
    """(b): at most 1 % of the last steps leave the box of r²."""
    outside = float(evidence.curves["b"].late().outside().mean())
    return Claim(
        "b-keeps-joint-angles",
        "Under G² = 0 the joint angles are kept within the bounds of r²",
        "§4.1, eq. of r²",
        {"share_outside": outside, "at_most": 0.01},
        f"{outside:.2%} of the last steps leave them; ≤ 1 % asked",
        outside <= 0.01,
    )


def c_square_increases(evidence: ArmEvidence) -> Claim:
    """(c): at least 80 of 100 late episodes, and 1.1 times as many as in the first block."""
    first, last = _mean(_opening(evidence.curves["c"]), "square"), _mean(evidence.curves["c"].late(), "square")
    return Claim(
        "c-square-increases",
        "the number of touches on the square objects increases",
        "§4.2, Fig. 7 (c)",
        {"square_first_block": first, "square_last": last, "at_least": 80, "times_first": 1.1},
        f"from {first:.1f} to {last:.1f} of 100 episodes; ≥ 80 and 1.1 times the first block asked",
        last >= max(80, 1.1 * first),
    )


def c_others_vanish(evidence: ArmEvidence) -> Claim:
    """(c): circle, star and triangle together at most 15 of 100 at last, and half of the first block's."""
    learned = evidence.curves["c"]
    first, last = _others(_opening(learned)), _others(learned.late())
    few = sum(learned.per_hundred()[:, :, learned.outcomes.index(name)].mean(axis=0) for name in _OTHERS) <= 15
    since = int(learned.episodes[few.argmax()]) if few.any() else 0
    return Claim(
        "c-others-vanish",
        "while those on other objects are gradually reduced to zero",
        "§4.2, Fig. 7 (c)",
        {"others_first_block": first, "others_last": last, "at_most": 15, "times_first": 0.5,
         "first_so_few_at_episode": since},  # 0: never
        f"from {first:.1f} to {last:.1f} of 100 episodes{f', first 15 or fewer by episode {since}' if since else ''}; "
        "≤ 15 and half of the first block asked",
        last <= min(15, 0.5 * first),
    )  # fmt: skip


def threshold_matters(evidence: ArmEvidence) -> Claim:
    """(c) touches the square at least 50 times more of 100 than (b)."""
    with_zero, with_half = (_mean(evidence.curves[name].late(), "square") for name in ("b", "c"))
    return Claim(
        "threshold-matters",
        "G³ (printed G²) is a sensitive threshold that affects the resultant behaviours",
        "§4.2",
        {"square_b": with_zero, "square_c": with_half, "difference_at_least": 50},
        f"square touches of 100 late episodes: (b) {with_zero:.1f}, (c) {with_half:.1f}; 50 apart asked",
        with_half - with_zero >= 50,
    )


def a_winner_takes_all(evidence: ArmEvidence) -> Claim:
    """(a), mean over the runs: the most touched object has 50 of 100 late episodes, and twice the second's."""
    rates = evidence.curves["a"].late().rates()[:, :-1]
    second, first = (float(rate) for rate in np.sort(rates, axis=1)[:, -2:].mean(axis=0))
    winners = {name: int((rates.argmax(axis=1) == k).sum()) for k, name in enumerate(evidence.curves["a"].arm.events)}
    return Claim(
        "a-winner-takes-all",
        "Without constraints a run ends with one object, not with all four, though r¹ is the same at each",
        OURS,
        {"most_touched": first, "second": second, "at_least": 50, "times_second": 2,
         **{f"runs_won_by_{name}": number for name, number in winners.items()}},
        f"the most touched object has {first:.1f} of 100 late episodes, the second {second:.1f}; ≥ 50 and twice the "
        f"second asked. Most touched: {', '.join(f'{name} in {k}' for name, k in winners.items() if k)} runs",
        first >= max(50, 2 * second),
    )  # fmt: skip


def c_out_of_reach(evidence: ArmEvidence) -> Claim:
    """(c): the bound on ρ³, and what every run reaches, lie below G³."""
    threshold, bound = _threshold("c"), greatest_average_r3(evidence.curves["c"].arm)
    reached = float(max(evidence.curves[name].late().average_r3("step").max() for name in evidence.curves))
    return Claim(
        "c-threshold-out-of-reach",
        "G³ = 0.5 per step cannot be met, a touch taking several steps: in (c) the constraint stays active for ever",
        OURS,
        {"greatest_average": bound, "best_reached": reached, "threshold": threshold},
        f"no policy exceeds ρ³ = {bound:.3f} per step; the best run of all conditions reaches {reached:.3f}",
        bound < threshold and reached < threshold,
    )


def c_episode_met(evidence: ArmEvidence) -> Claim:
    """(c) with ρ³ per episode: at least 0.6 at last, with slack over 0.5."""
    late = evidence.curves["c-episode"].late()
    average = float(late.average_r3("episode").mean())
    return Claim(
        "c-episode-met-with-slack",
        "G³ = 0.5 is met with slack where ρ³ is averaged per episode",
        OURS,
        {"average_per_episode": average, "threshold": _threshold("c-episode"), "at_least": 0.6,
         **_rates("late", late)},
        f"ρ³ = {average:.3f} per episode at last; ≥ 0.6 asked. Late episodes: {_told(late)}",
        average >= 0.6,
    )  # fmt: skip


def c_feasible_met(evidence: ArmEvidence) -> Claim:
    """(c) with G³ = 0.1: ρ³ at least 0.08 per step at last, the threshold but for a fifth."""
    late = evidence.curves["c-feasible"].late()
    average = float(late.average_r3("step").mean())
    return Claim(
        "c-feasible-met",
        "G³ = 0.1 per step, which is feasible, is met",
        OURS,
        {"average_per_step": average, "threshold": _threshold("c-feasible"), "at_least": 0.08, **_rates("late", late)},
        f"ρ³ = {average:.3f} per step at last; ≥ 0.08 asked. Late episodes: {_told(late)}",
        average >= 0.08,
    )


def projection_not_shown(evidence: ArmEvidence) -> Claim:
    """(c) without P: every rate within 15 of 100 of (c)'s."""
    projected, whole = evidence.curves["c"].late(), evidence.curves["c-no-projection"].late()
    apart = float(abs(projected.rates().mean(axis=0) - whole.rates().mean(axis=0)).max())
    return Claim(
        "projection-not-shown-by-fig7",
        "Fig. 7 does not tell projection from gradient plus restoration: (c) without P ends the same",
        OURS,
        {"largest_difference": apart, "at_most": 15, **_rates("with_P", projected), **_rates("without_P", whole)},
        f"touches of 100 late episodes differ by {apart:.1f} at most; ≤ 15 asked. Without P: {_told(whole)}",
        apart <= 15,
    )


_CLAIMS: tuple[tuple[tuple[str, ...], Callable[[ArmEvidence], Claim]], ...] = (
    (("a",), a_learns_touching),
    (("b",), b_touches_star_early),
    (("b",), b_avoids_star),
    (("b",), b_touches_triangle),
    (("b",), b_keeps_angles),
    (("c",), c_square_increases),
    (("c",), c_others_vanish),
    (("b", "c"), threshold_matters),
    (("a",), a_winner_takes_all),
    (("c",), c_out_of_reach),
    (("c-episode",), c_episode_met),
    (("c-feasible",), c_feasible_met),
    (("c", "c-no-projection"), projection_not_shown),
)


def _mean(curves: TouchCurves, outcome: str) -> float:
    return float(curves.rate(outcome).mean())


def _opening(curves: TouchCurves) -> TouchCurves:
    """The first block."""
    return curves.within(0, int(curves.episodes[0]))


def _others(curves: TouchCurves) -> float:
    return sum(_mean(curves, outcome) for outcome in _OTHERS)


def _rates(prefix: str, curves: TouchCurves) -> dict[str, float]:
    return {f"{prefix}_{outcome}": _mean(curves, outcome) for outcome in curves.outcomes}


def _told(curves: TouchCurves) -> str:
    return ", ".join(f"{outcome} {_mean(curves, outcome):.1f}" for outcome in curves.outcomes)


def _threshold(condition: str) -> float:
    thresholds = CONDITIONS[condition].thresholds
    assert thresholds is not None  # every (c) has both
    return thresholds[1]
