"""Heat maps family × solver as tables, so that they can be read aloud, copied, scrolled and sorted."""

from collections.abc import Sequence

from .findings import Findings
from .heat_colours import level
from .html_table import caption, column_head, row_head, table
from .markup import Markup, element, join
from .measurement import Cell
from .tallies import Tally
from .wording import NOTHING, percent_text

_VARIANT_WORDS = {"prepared": "behind the preparation", "raw": "raw back ends"}


def heat_maps(findings: Findings) -> Markup:
    """Success and silently wrong, each behind the preparation and, where measured, raw."""
    variants = [name for name, pool in (("prepared", findings.prepared), ("raw", findings.raw)) if pool]
    maps = [(kind, variant) for kind in ("success", "wrong") for variant in variants]
    return join(_heat_map(findings, kind, variant, f"Map {number}.") for number, (kind, variant) in enumerate(maps, 1))


def _heat_map(findings: Findings, kind: str, variant: str, number: str) -> Markup:
    pool = findings.prepared if variant == "prepared" else findings.raw
    solvers = [each.solver for each in pool]
    heads = [element("th", "family", scope="col", data_column=0)]
    heads += [column_head(solver, column, class_="upright") for column, solver in enumerate(solvers, 1)]
    rows = [[_all_head(), *(_total(kind, each) for each in pool)]]
    met = [family for family in findings.families if any((s, variant, family) in findings.cells for s in solvers)]
    for order, family in enumerate(met):
        cells = [findings.cells.get((solver, variant, family)) for solver in solvers]
        rows.append([_family_head(family, order), *(_cell(kind, cell) for cell in cells)])
    words = _VARIANT_WORDS[variant]
    if kind == "success":
        lead = f"Success, {words}: percent of the problems of a family that a solver takes."
        more = join(
            [
                "Dark is all, pale is none (in dark mode bright is all). ",
                element("span", "▲2", class_="flag"),
                " counts answers in the cell that are silently wrong. Hatched: not taken.",
            ]
        )
        label = f"Success by family and solver, {words}"
    else:
        lead = f"Silently wrong, {words}: percent of answers that claim to be optimal and are not."
        more = join(["A dot is none: the best result. Hatched: not taken."])
        label = f"Silently wrong by family and solver, {words}"
    return table(caption(number, lead, more), [heads], rows, label=label, class_="heat")


def _family_head(family: str, order: int) -> Markup:
    return row_head(element("a", family, href=f"#family-{family}"), value=order)


def _all_head() -> Markup:
    return row_head(element("b", "all families"), value=-1)


def _total(kind: str, each: Tally) -> Markup:
    return _square(
        kind, each.percent("success" if kind == "success" else "silently-wrong"), each.count("silently-wrong")
    )


def _cell(kind: str, cell: Cell | None) -> Markup:
    if cell is None:
        return element("td", class_="missing", data_value="", title="not measured")
    taken = cell.problems - cell.unsupported
    count = cell.success if kind == "success" else cell.silently_wrong
    return _square(kind, 100.0 * count / taken if taken else None, cell.silently_wrong, _note(cell))


def _square(kind: str, percent: float | None, wrong: int, note: str | None = None) -> Markup:
    if percent is None:
        return element("td", NOTHING, class_="untaken", data_value="", title="not taken")
    shade = f"{kind}-{level(percent / 100.0)}"
    if kind == "wrong" and percent == 0.0:
        return element("td", "·", class_=shade, data_value="0", title=note)
    flag = element("span", f"▲{wrong}", class_="flag") if kind == "success" and wrong else None
    hidden = element("span", " silently wrong", class_="hidden") if flag else None
    text = percent_text(percent, 0)
    return element("td", text, flag, hidden, class_=shade, data_value=f"{percent:.12g}", title=note)


def _note(cell: Cell) -> str:
    """The counts that are not zero, in words."""
    names: Sequence[str] = (
        "success", "inaccurate", "silently_wrong", "honest_failure", "false_infeasible", "missed_infeasible",
        "hang", "crash", "unsupported",
    )  # fmt: skip
    counts = [f"{getattr(cell, name)} {name.replace('_', ' ')}" for name in names if getattr(cell, name)]
    return f"{cell.solver}, {cell.family}: {', '.join(counts)} of {cell.problems}"
