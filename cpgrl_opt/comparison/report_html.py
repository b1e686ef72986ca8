"""report.html: one file that needs no other, for a phone and a desktop, by day and by night."""

from collections.abc import Iterable
from importlib.resources import files

from .choice import RULE
from .findings import Findings
from .heat_colours import heat_styles
from .heat_map import heat_maps, time_map
from .html_table import caption, simple_table
from .markup import Markup, element, join
from .outcome_bars import outcome_bars
from .profile_drawing import overview, panels
from .report_tables import family_table, preparation_table, solver_table
from .wording import astray_sentence, choice_sentences, limitations, question, terms

TITLE = "Comparison of direction solvers"


def html_report(findings: Findings) -> str:
    """The whole page."""
    sections = [
        ("choice", "Which solver to choose", _choice(findings)),
        ("outcomes", "Outcomes at a glance", _outcomes(findings)),
        ("solvers", "Solvers in numbers", _numbers(findings)),
        ("maps", "Family by family", heat_maps(findings)),
        ("preparation", "What the preparation buys", preparation_table(findings)),
        ("time", "Time", _time(findings)),
        ("families", "The families", family_table(findings)),
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


def _numbers(findings: Findings) -> Markup:
    sentence = astray_sentence(findings)
    return join([solver_table(findings), *([element("p", sentence)] if sentence else [])])


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
            time_map(findings),
        ]
    )


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
