"""Numbers and sentences that both documents share, so that they cannot differ."""

from .choice import Choice
from .findings import FAR, Findings
from .tallies import UNSAFE, Tally

NOTHING = "–"
FAR_TEXT = f"{FAR:.0e}".replace("e-0", "e-")


def percent_text(value: float | None, digits: int = 1) -> str:
    """A percentage, rounded, but only all reads 100 and only none reads 0; – where nothing was asked."""
    if value is None:
        return NOTHING
    if value in (0.0, 100.0):
        return f"{value:.0f}"
    unit = 10.0**-digits
    if value < unit:
        return f"<{unit:.{digits}f}"
    return f"{min(value, 100.0 - unit):.{digits}f}"


def ratio_text(value: float | None) -> str:
    """A time ratio to two figures, or – ; whole numbers from 10 on."""
    if value is None:
        return NOTHING
    return f"{value:.2g}" if value < 10 else f"{float(f'{value:.3g}'):,.0f}".replace(",", "\u202f")


def distance_text(value: float | None) -> str:
    """A relative distance to one figure, or –."""
    return NOTHING if value is None else f"{value:.0e}" if value else "0"


def astray_sentence(findings: Findings) -> str:
    """What is certified, yet far from the exact direction; nothing where no family is ill-posed."""
    known = [each for each in findings.astray if each.certified]
    if not known:
        return ""
    far = sorted((each for each in known if each.far), key=lambda each: -each.largest)
    told = [f"{each.far} of {each.certified} on {each.family} (up to {distance_text(each.largest)})" for each in far]
    others = [each.family for each in known if not each.far]
    parts = [", ".join(told) or "none", *([f"none on {', '.join(others)}"] if told and others else [])]
    return (
        "Certified, yet far from the exact direction: on an ill-posed family float64 does not determine the direction, "
        "since data that differ by rounding have other directions. Of the answers behind the preparation that count as "
        f"success there, this many are farther than {FAR_TEXT} from the exact direction: {'; '.join(parts)}."
    )


def question(findings: Findings) -> str:
    """What was asked, in a sentence or two."""
    return (
        "Which solver returns the right direction min ½‖d − g‖² subject to Jd ≥ b (or = b), on some families in a "
        "metric M or as max gᵀd in a ball, which says so when it "
        f"cannot, and at what cost? {len(findings.solvers)} solvers met {findings.problems} problems of "
        f"{len(findings.families)} families, each chosen for a reason given below: {findings.measured} measurements. "
        "An independent referee computes every residual from the problem's data; what a back end reports about "
        "itself counts for nothing."
    )


def terms() -> tuple[tuple[str, str], ...]:
    """(term, meaning) of every column."""
    return (
        (
            "prepared",
            "the solver as this package offers it: unit rows, at most m + 1 coordinates, the answer polished once on "
            "the face found, judged by the referee before it is claimed; infeasibility is proven by the package's own "
            "projection, whatever the back end.",
        ),
        (
            "raw",
            "the library called directly, its settings left at their defaults, its claims passed on unchecked; on "
            "small problems without metric and ball only.",
        ),
        (
            "success",
            "right verdict and all residuals ≤ 1e-9; where infeasible, INFEASIBLE with a Farkas vector that checks "
            "and, behind the preparation, the direction that violates least.",
        ),
        (
            "inaccurate",
            "claimed optimal, worst residual between 1e-9 and 1e-6; or rightly called infeasible without a proof, "
            "or without that direction.",
        ),
        ("silently wrong", "claimed optimal, worst residual above 1e-6."),
        ("honest failure", "no answer claimed: the status says so."),
        (
            "false / missed infeasible",
            "a feasible problem called infeasible, without proof / an infeasible one not recognised.",
        ),
        ("hang, crash", "killed at the time limit; ended the process or raised."),
        ("noise", "problems on which it wrote to stdout or stderr."),
        ("not taken", "problems of a kind that the solver declares not to take; they enter no percentage."),
    )


def choice_sentences(choice: Choice, default_solver: str) -> list[str]:
    """What the rule chose, with the numbers that made it do so."""
    if choice.first is None:
        return ["No solver was measured behind the preparation, so there is none to recommend."]
    found = [f"Choose {choice.first.solver}: {_merits(choice.first, default_solver)}."]
    if choice.second is not None:
        found.append(
            f"To check it by another method: {choice.second.solver}, the rule's choice among the others: "
            f"{_merits(choice.second, default_solver)}."
        )
    found += [
        f"Where every problem is one that it takes ({', '.join(each.families)}), {each.solver} solves all, in "
        f"{ratio_text(each.time_ratio)} × {default_solver}'s time against {choice.first.solver}'s "
        f"{ratio_text(each.choice_time_ratio)} ×."
        for each in choice.specialists
    ]
    return found


def _merits(each: Tally, default_solver: str) -> str:
    if each.solver == default_solver:
        pace = "the solver to whose time all others' are ratios"
    else:
        pace = f"{ratio_text(each.time_ratio)} × {default_solver}'s time, failures counted at the limit"
    solved = f"{percent_text(each.percent('success'))} % success on {each.taken} of {each.problems} problems"
    return f"{solved}, {unsafe_text(each)}, {pace}"


def unsafe_text(each: Tally) -> str:
    """Its unsafe answers by kind, or that there are none."""
    kinds = [f"{outcome.replace('-', ' ')} {each.count(outcome)}" for outcome in UNSAFE if each.count(outcome)]
    return ", ".join(kinds) if kinds else "no unsafe answer"


def limitations(findings: Findings) -> list[str]:
    """What the numbers cannot say."""
    raw = f" Raw back ends met {findings.common_problems} of the {findings.problems} problems." if findings.raw else ""
    return [
        "Most families are hostile on purpose. A percentage is the share of these problems, each weighing the same; "
        "it is no estimate of how often a solver fails in training.",
        "Times are CPU seconds on one machine, in Python, wrapper included, as ratios to "
        f"{findings.context.default_solver} in the same round-robin; other machines, sizes and versions "
        "order them differently. "
        "Differences below a factor of about 1.5 mean little.",
        "A failure costs the time limit in every mean of times, so that giving up early is not rewarded; a longer "
        "limit makes the same failures look slower.",
        "Raw back ends run at their libraries' defaults. Those of first-order and interior-point methods ask for less "
        "than the 1e-9 that counts as success here, so much of what is inaccurate is a matter of settings; silently "
        f"wrong is not.{raw}",
        "What the preparation adds is not scaling alone: polishing and proofs of infeasibility are the package's "
        "own work, so agreement of prepared solvers on infeasible problems is no independent evidence.",
        "The referee's residuals are relative to the sizes of g and d on unit rows. Rows closer to opposing than about "
        "1e-10 rad cannot be certified in float64: there an honest failure is the best possible answer.",
        "Residuals say how well an answer solves a problem near the one given: at an angle θ from opposing or parallel "
        "rows, a residual ε allows a direction that is off by ε/θ. The distance to the exact direction, by rational "
        "arithmetic on feasible problems that are small enough, shows it; families on which float64 does not determine "
        "the direction have a column of their own there.",
        "One seed, one draw of each problem: percentages of a family with few problems move in large steps.",
        "The authors of the default solver wrote this comparison. The measurements lie beside the report, "
        "and the command below makes them again.",
    ]
