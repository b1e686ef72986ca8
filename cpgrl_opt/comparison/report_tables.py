"""The page's three tables of numbers: solvers, what the preparation buys, families."""

from .findings import FamilyRow, Findings
from .html_table import (
    caption,
    column_head,
    column_heads,
    group_head,
    number_cell,
    row_head,
    table,
    text_cell,
)
from .markup import Markup, element
from .tallies import Gain, Tally
from .wording import distance_text, percent_text, ratio_text, unsafe_text

_SHARES = (
    ("success %", "success"),
    ("inaccurate %", "inaccurate"),
    ("silently wrong %", "silently-wrong"),
    ("honest failure %", "honest-failure"),
    ("false infeasible %", "false-infeasible"),
    ("missed infeasible %", "missed-infeasible"),
)


def solver_table(findings: Findings) -> Markup:
    """A row per solver, prepared and raw side by side."""
    counted = ("hangs", "crashes", "noise")
    titles = ["problems", *(title for title, _ in _SHARES), *counted, "distance", "distance, ill-posed", "time ratio"]
    variants = [("prepared", "prep.")] + ([("raw", "raw")] if findings.raw else [])
    groups = [element("th", class_="group"), *(group_head(title, len(variants)) for title in titles)]
    names = [name for _ in titles for _, name in variants]
    heads = [column_head("solver", 0), *(column_head(name, place) for place, name in enumerate(names, 1))]
    rows = []
    for solver in findings.solvers:
        columns = zip(*(_figures(findings.tally(solver, variant)) for variant, _ in variants), strict=True)
        rows.append([row_head(solver), *(cell for column in columns for cell in column)])
    more = (
        "Prep.: behind the preparation. Percent of the problems taken, all families pooled; noise: problems "
        "with output on stdout or stderr; "
        "distance: the largest from the exact direction, relative, on well-posed families; ill-posed: where "
        "float64 does not determine that direction; time ratio: geometric mean of CPU time over "
        f"{findings.context.default_solver}'s, failures counted at the time limit. Click a heading to sort."
    )
    text = caption("Table 1.", "Every solver behind the preparation, and raw beside it.", more)
    return table(text, [groups, heads], rows, label="Solvers in numbers", class_="paired")


def _figures(each: Tally | None) -> list[Markup]:
    if each is None:
        return [number_cell("–", None) for _ in range(len(_SHARES) + 7)]
    shares = [(each.percent(outcome), outcome) for _, outcome in _SHARES]
    return [
        number_cell(str(each.taken), each.taken),
        *(number_cell(percent_text(share), share, _alarm(outcome, share)) for share, outcome in shares),
        number_cell(str(each.count("hang")), each.count("hang"), _alarm("hang", each.count("hang"))),
        number_cell(str(each.count("crash")), each.count("crash"), _alarm("crash", each.count("crash"))),
        number_cell(str(each.noise), each.noise, _alarm("noise", each.noise)),
        number_cell(distance_text(each.distance_max), each.distance_max),
        number_cell(distance_text(each.ill_posed_distance), each.ill_posed_distance),
        number_cell(ratio_text(each.time_ratio), each.time_ratio),
    ]


def _alarm(outcome: str, value: float | None) -> str | None:
    """Zeros step back; a silently wrong answer steps forward."""
    if not value:
        return "zero"
    return "alarm" if outcome == "silently-wrong" else None


def preparation_table(findings: Findings) -> Markup | None:
    """A row per solver that was measured both ways; None without any."""
    if not findings.gains:
        return None
    titles = (
        "solver",
        "problems",
        "success % raw",
        "success % prepared",
        "gain, points",
        "unsafe raw",
        "unsafe prepared",
        "raw, by kind",
    )
    heads = column_heads(titles, words=("raw, by kind",))
    more = "Only problems that both variants took. Unsafe: silently wrong, false or missed infeasible, hang, crash."
    text = caption("Table 2.", "The same problems raw and behind the preparation.", more)
    return table(text, [heads], [_gain_row(gain) for gain in findings.gains], label="What the preparation buys")


def _gain_row(gain: Gain) -> list[Markup]:
    raw, prepared = gain.raw, gain.prepared
    return [
        row_head(raw.solver),
        number_cell(str(raw.problems), raw.problems),
        number_cell(percent_text(raw.percent("success")), raw.percent("success")),
        number_cell(percent_text(prepared.percent("success")), prepared.percent("success")),
        number_cell(f"{gain.points:+.1f}", gain.points),
        number_cell(str(raw.unsafe), raw.unsafe),
        number_cell(str(prepared.unsafe), prepared.unsafe),
        text_cell(unsafe_text(raw), class_="words long"),
    ]


def family_table(findings: Findings) -> Markup:
    """A row per family, with its reason."""
    titles = ("family", "why it is there", "problems", "solvers that solve all", "success %", "success % raw",
              "silently wrong", "silently wrong raw", "fastest that solves all", "its time ratio")  # fmt: skip
    heads = column_heads(titles, words=("why it is there", "fastest that solves all"))
    more = "Success and silently wrong: over all solvers that take it together. Solve all: of those that take any."
    text = caption("Table 3.", "What each family asks, and who can answer.", more)
    return table(text, [heads], [_family_cells(row) for row in findings.rows], label="Families", class_="families")


def _family_cells(row: FamilyRow) -> list[Markup]:
    pair = row.prepared, row.raw
    shares = [each.percent("success") if each else None for each in pair]
    wrong = [each.count("silently-wrong") if each else None for each in pair]
    return [
        row_head(row.family, id_=f"family-{row.family}"),
        text_cell(row.reason, class_="words long"),
        number_cell(str(row.problems), row.problems),
        number_cell(f"{len(row.solving)} of {row.asked}", len(row.solving), note=", ".join(row.solving) or "none"),
        *(number_cell(percent_text(share), share) for share in shares),
        *(number_cell("–" if n is None else str(n), n, _alarm("silently-wrong", n)) for n in wrong),
        text_cell(row.fastest or "–"),
        number_cell(ratio_text(row.time_ratio), row.time_ratio),
    ]
