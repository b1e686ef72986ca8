"""How every solver's problems ended, as one bar of 100 % a variant."""

from .findings import Findings
from .markup import Markup, element, join
from .tallies import Tally
from .wording import percent_text

PARTS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("good", "success", ("success",)),
    ("near", "inaccurate", ("inaccurate",)),
    ("honest", "honest failure", ("honest-failure",)),
    ("verdict", "false or missed infeasible", ("false-infeasible", "missed-infeasible")),
    ("ended", "hang or crash", ("hang", "crash")),
    ("wrong", "silently wrong", ("silently-wrong",)),
)


def outcome_bars(findings: Findings) -> Markup:
    """Solvers below each other, the best first."""
    legend = [element("li", element("i", class_=f"swatch {name}"), word) for name, word, _ in PARTS]
    rows = [_row(findings, solver) for solver in findings.solvers]
    return join([element("ul", *legend, class_="legend"), element("div", *rows, class_="bars")])


def _row(findings: Findings, solver: str) -> Markup:
    pair = (("prepared", findings.tally(solver, "prepared")), ("raw", findings.tally(solver, "raw")))
    bars = [_bar(variant, each) for variant, each in pair if each is not None and each.taken]
    return element("div", element("div", solver, class_="name"), element("div", *bars), class_="bar-row")


def _bar(variant: str, each: Tally) -> Markup:
    shares = [(name, word, sum(each.percent(o) or 0.0 for o in outcomes)) for name, word, outcomes in PARTS]
    spoken = ", ".join(f"{word} {percent_text(share)} %" for _, word, share in shares if share)
    parts = [element("i", class_=name, style=f"flex-grow:{share:.4g}") for name, _, share in shares if share]
    bar = element(
        "div", *parts, class_="bar", role="img", aria_label=f"{each.solver} {variant}: {spoken}", title=spoken
    )
    share = percent_text(each.percent("success"))
    is_part = each.taken < each.problems
    of = f", n = {each.taken} of {each.problems}" if is_part else f", n = {each.taken}"
    number = element("span", of, class_=None if is_part else "wide")
    note = element("div", f"{variant} {share} %", number, class_="note")
    return element("div", bar, note, class_="bar-line")
