"""report.html: one file that needs no other, for a phone and a desktop, by day and by night."""

from collections.abc import Iterable
from importlib.resources import files

from .choice import RULE
from .findings import FamilyRow, Findings
from .heat_colours import heat_styles
from .heat_map import heat_maps
from .html_table import caption, column_head, group_head, number_cell, row_head, simple_table, table, text_cell
from .markup import Markup, element, join
from .outcome_bars import outcome_bars
from .profile_drawing import overview, panels
from .tallies import Gain, Tally
from .wording import (
    choice_sentences,
    distance_text,
    limitations,
    percent_text,
    question,
    ratio_text,
    terms,
    unsafe_text,
)

TITLE = "Comparison of direction solvers"


def html_report(findings: Findings) -> str:
    """The whole page."""
    sections = [
        ("choice", "Which solver to choose", _choice(findings)),
        ("outcomes", "Outcomes at a glance", _outcomes(findings)),
        ("solvers", "Solvers in numbers", _solver_table(findings)),
        ("maps", "Family by family", heat_maps(findings)),
        ("preparation", "What the preparation buys", _preparation(findings)),
        ("time", "Time", _time(findings)),
        ("families", "The families", _family_table(findings)),
        ("limitations", "Limitations", _list("ul", limitations(findings))),
        ("making", "How it was made", _making(findings)),
    ]
    shown = [(key, title, body) for key, title, body in sections if body]
    links = [element("li", element("a", title, href=f"#{key}")) for key, title, _ in shown]
    main = element(
        "main",
        element("header", element("h1", TITLE), element("p", question(findings), class_="question")),
        element("nav", element("ul", *links), aria_label="Contents"),
        *(element("section", element("h2", title), body, id=key) for key, title, body in shown),
    )
    return f"<!DOCTYPE html>\n{element('html', _head(), element('body', main, _script()), lang='en')}\n"


def _head() -> Markup:
    return element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("title", TITLE),
        element("style", Markup(f"\n{_asset('report.css')}\n{heat_styles()}\n")),
    )


def _script() -> Markup:
    return element("script", Markup(f"\n{_asset('report.js')}"))


def _asset(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


def _list(tag: str, sentences: Iterable[str]) -> Markup:
    return element(tag, *(element("li", sentence) for sentence in sentences))


def _choice(findings: Findings) -> Markup:
    first, *others = choice_sentences(findings.choice, findings.context.default_solver)
    rule = element("details", element("summary", "The rule behind this"), _list("ol", RULE))
    return join([element("p", first, class_="answer"), *(element("p", each) for each in others), rule])


def _outcomes(findings: Findings) -> Markup:
    more = "Upper bar: behind the preparation; lower, narrower bar: the raw back end, which meets small problems only."
    text = caption("Figure 1.", "How the problems that a solver takes ended.", more if findings.raw else "")
    words = [join([element("dt", term), element("dd", meaning)]) for term, meaning in terms()]
    glossary = element("details", element("summary", "What the words mean"), element("dl", *words))
    return join([element("figure", element("figcaption", text), outcome_bars(findings)), glossary])


_SHARES = (
    ("success %", "success"),
    ("inaccurate %", "inaccurate"),
    ("silently wrong %", "silently-wrong"),
    ("honest failure %", "honest-failure"),
    ("false infeasible %", "false-infeasible"),
    ("missed infeasible %", "missed-infeasible"),
)


def _solver_table(findings: Findings) -> Markup:
    titles = ["problems", *(title for title, _ in _SHARES), "hangs", "crashes", "noise", "distance", "time ratio"]
    variants = ("prepared", "raw") if findings.raw else ("prepared",)
    groups = [element("th", class_="group"), *(group_head(title, len(variants)) for title in titles)]
    names = [variant for _ in titles for variant in variants]
    heads = [column_head("solver", 0), *(column_head(name, place) for place, name in enumerate(names, 1))]
    rows = []
    for solver in findings.solvers:
        columns = zip(*(_figures(findings.tally(solver, variant)) for variant in variants), strict=True)
        rows.append([row_head(solver), *(cell for column in columns for cell in column)])
    more = (
        "Percent of the problems taken, all families pooled; noise: problems with output on stdout or stderr; "
        "distance: the largest from the exact direction, relative; time ratio: geometric mean of CPU time over "
        f"{findings.context.default_solver}'s, failures counted at the time limit. Click a heading to sort."
    )
    text = caption("Table 1.", "Every solver behind the preparation, and raw beside it.", more)
    return table(text, [groups, heads], rows, label="Solvers in numbers", class_="paired")


def _figures(each: Tally | None) -> list[Markup]:
    if each is None:
        return [number_cell("–", None) for _ in range(len(_SHARES) + 6)]
    shares = [(each.percent(outcome), outcome) for _, outcome in _SHARES]
    return [
        number_cell(str(each.taken), each.taken),
        *(number_cell(percent_text(share), share, _alarm(outcome, share)) for share, outcome in shares),
        number_cell(str(each.count("hang")), each.count("hang"), _alarm("hang", each.count("hang"))),
        number_cell(str(each.count("crash")), each.count("crash"), _alarm("crash", each.count("crash"))),
        number_cell(str(each.noise), each.noise, _alarm("noise", each.noise)),
        number_cell(distance_text(each.distance_max), each.distance_max),
        number_cell(ratio_text(each.time_ratio), each.time_ratio),
    ]


def _alarm(outcome: str, value: float | None) -> str | None:
    """Zeros step back; a silently wrong answer steps forward."""
    if not value:
        return "zero"
    return "alarm" if outcome == "silently-wrong" else None


def _preparation(findings: Findings) -> Markup | None:
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
    heads = [column_head(title, place) for place, title in enumerate(titles)]
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
        text_cell(unsafe_text(raw)),
    ]


def _time(findings: Findings) -> Markup | None:
    if not findings.profiles:
        return None
    first = caption(
        "Figure 2.",
        "Performance profiles behind the preparation: the share of problems solved within a factor τ of the fastest.",
        "Higher and further left is better. The number beside a name is the share solved in the end, in percent; what "
        "fails, or is not taken, is never solved, so such a curve stays below 100.",
    )
    second = caption(
        "Figure 3.",
        "One panel a solver"
        + (", behind the preparation (solid, blue) and raw (dashed, orange)." if findings.raw else "."),
        f"The axes are those of Figure 2, over the {findings.common_problems} problems that all were put to; "
        "in grey the other solvers behind the preparation.",
    )
    box = element(
        "div",
        overview(findings),
        class_="scroll",
        tabindex="0",
        role="region",
        aria_label="Performance profiles (scrolls)",
    )
    return join(
        [
            element("figure", element("figcaption", first), box),
            element("figure", element("figcaption", second), panels(findings)),
        ]
    )


def _family_table(findings: Findings) -> Markup:
    titles = ("family", "why it is there", "problems", "solvers that solve all", "success %", "success % raw",
              "silently wrong", "silently wrong raw", "fastest that solves all", "its time ratio")  # fmt: skip
    heads = [column_head(title, place) for place, title in enumerate(titles)]
    more = "Success and silently wrong: over all solvers that take it together. Solve all: of those that take any."
    text = caption("Table 3.", "What each family asks, and who can answer.", more)
    return table(text, [heads], [_family_cells(row) for row in findings.rows], label="Families", class_="families")


def _family_cells(row: FamilyRow) -> list[Markup]:
    pair = row.prepared, row.raw
    shares = [each.percent("success") if each else None for each in pair]
    wrong = [each.count("silently-wrong") if each else None for each in pair]
    return [
        row_head(row.family, id_=f"family-{row.family}"),
        text_cell(row.reason),
        number_cell(str(row.problems), row.problems),
        number_cell(f"{len(row.solving)} of {row.asked}", len(row.solving), note=", ".join(row.solving) or "none"),
        *(number_cell(percent_text(share), share) for share in shares),
        *(number_cell("–" if n is None else str(n), n, _alarm("silently-wrong", n)) for n in wrong),
        text_cell(row.fastest or "–"),
        number_cell(ratio_text(row.time_ratio), row.time_ratio),
    ]


def _making(findings: Findings) -> Markup:
    context = findings.context
    tables = [
        join([element("h3", title), simple_table([(str(key), str(value)) for key, value in pairs.items()], title)])
        for title, pairs in (
            ("Machine", context.machine),
            ("Versions", context.versions),
            ("Settings", context.settings),
        )
        if pairs
    ]
    command = element("pre", element("code", context.command), tabindex="0", aria_label="Command")
    seconds = element("p", f"Seed {context.seed}; {context.wall_seconds:.0f} s of wall time.")
    return join([command, seconds, element("div", *(element("div", each) for each in tables), class_="facts")])
