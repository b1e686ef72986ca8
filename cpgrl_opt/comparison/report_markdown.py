"""report.md: the comparison as Markdown tables."""

from collections.abc import Iterable, Sequence

from .choice import RULE
from .findings import FamilyRow, Findings
from .markdown_text import block, code, text
from .tallies import Gain, Tally
from .wording import (
    NOTHING,
    astray_sentence,
    choice_sentences,
    distance_text,
    limitations,
    percent_text,
    question,
    ratio_text,
    terms,
    unsafe_text,
)

_SHARES = (
    ("success %", "success"),
    ("inaccurate %", "inaccurate"),
    ("silently wrong %", "silently-wrong"),
    ("honest failure %", "honest-failure"),
    ("false infeasible %", "false-infeasible"),
    ("missed infeasible %", "missed-infeasible"),
)


def markdown_report(findings: Findings) -> str:
    """The whole document."""
    context = findings.context
    sections = [
        "# Comparison of direction solvers",
        question(findings),
        "## Which solver to choose",
        _bullets(map(text, choice_sentences(findings.choice, context.default_solver))),
        "The rule, applied to the numbers below:",
        "\n".join(f"{number}. {step}" for number, step in enumerate(RULE, 1)),
        "## Solvers",
        "Each cell: behind the preparation / raw. Percentages are of the problems taken, all families pooled; "
        "distance is the largest from the exact direction, relative, on well-posed families and on ill-posed ones, of "
        "which float64 does not determine the direction; time ratio is the geometric mean of CPU time over "
        f"{context.default_solver}'s, failures counted at the time limit.",
        _bullets(f"**{term}**: {meaning}" for term, meaning in terms()),
        _main_table(findings),
        text(astray_sentence(findings)),
        *_preparation(findings),
        "## Families",
        "Solved by: the solvers behind the preparation that solve every problem of the family, of those that take it. "
        "Wrong: silently wrong answers of all solvers together, behind the preparation / raw.",
        _family_table(findings.rows),
        "## Limitations",
        _bullets(map(text, limitations(findings))),
        "## How it was made",
        block(context.command),
        f"Seed {context.seed}; {context.wall_seconds:.0f} s of wall time.",
        *(
            f"### {title}\n\n"
            + _table((title, "value"), [(text(str(key)), text(str(value))) for key, value in pairs.items()])
            for title, pairs in (
                ("Machine", context.machine),
                ("Versions", context.versions),
                ("Settings", context.settings),
            )
        ),
    ]
    return "\n\n".join(section for section in sections if section) + "\n"


def _main_table(findings: Findings) -> str:
    header = [
        "solver",
        "problems taken",
        *(title for title, _ in _SHARES),
        "hangs",
        "crashes",
        "noise",
        "distance",
        "distance, ill-posed",
        "time ratio",
    ]
    rows = []
    for solver in findings.solvers:
        pair = findings.tally(solver, "prepared"), findings.tally(solver, "raw")
        columns = list(zip(*(_figures(each) for each in pair), strict=True))
        rows.append((code(solver), *(f"{ours} / {theirs}" for ours, theirs in columns)))
    return _table(header, rows)


def _figures(each: Tally | None) -> list[str]:
    if each is None:
        return [NOTHING] * (len(_SHARES) + 7)
    return [
        str(each.taken),
        *(percent_text(each.percent(outcome)) for _, outcome in _SHARES),
        str(each.count("hang")),
        str(each.count("crash")),
        str(each.noise),
        distance_text(each.distance_max),
        distance_text(each.ill_posed_distance),
        ratio_text(each.time_ratio),
    ]


def _preparation(findings: Findings) -> list[str]:
    if not findings.gains:
        return []
    header = (
        "solver",
        "problems",
        "success % raw",
        "success % prepared",
        "gain, points",
        "unsafe raw",
        "unsafe prepared",
    )
    return [
        "## What the preparation buys",
        "The same problems, taken by both variants; unsafe = silently wrong, false or missed infeasible, hang, crash.",
        _table(header, [_gain_row(gain) for gain in findings.gains]),
    ]


def _gain_row(gain: Gain) -> tuple[str, ...]:
    return (
        code(gain.raw.solver),
        str(gain.raw.problems),
        percent_text(gain.raw.percent("success")),
        percent_text(gain.prepared.percent("success")),
        f"{gain.points:+.1f}",
        f"{gain.raw.unsafe} ({unsafe_text(gain.raw)})" if gain.raw.unsafe else "0",
        f"{gain.prepared.unsafe} ({unsafe_text(gain.prepared)})" if gain.prepared.unsafe else "0",
    )


def _family_table(rows: Sequence[FamilyRow]) -> str:
    header = (
        "family",
        "why it is there",
        "problems",
        "solved by",
        "success % prepared / raw",
        "wrong",
        "fastest that solves all",
    )
    return _table(header, [_family_cells(row) for row in rows])


def _family_cells(row: FamilyRow) -> tuple[str, ...]:
    pair = row.prepared, row.raw
    success = " / ".join(percent_text(each.percent("success")) if each else NOTHING for each in pair)
    wrong = " / ".join(str(each.count("silently-wrong")) if each else NOTHING for each in pair)
    fastest = f"{code(row.fastest)} ({ratio_text(row.time_ratio)})" if row.fastest else NOTHING
    return (
        code(row.family),
        text(row.reason),
        str(row.problems),
        f"{len(row.solving)} of {row.asked}",
        success,
        wrong,
        fastest,
    )


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _bullets(sentences: Iterable[str]) -> str:
    return "\n".join(f"- {sentence}" for sentence in sentences)
