"""Heat maps family × solver as tables, so that they can be read aloud, copied, scrolled and sorted."""

import math
from collections.abc import Sequence

from .findings import Findings
from .heat_colours import level
from .html_table import caption, column_head, row_head, table
from .markup import Markup, element, join
from .measurement import Cell
from .tallies import Tally
from .wording import NOTHING, percent_text, ratio_text

_VARIANT_WORDS = {"prepared": "behind the preparation", "raw": "raw back ends"}


def heat_maps(findings: Findings) -> Markup:
    """Success and silently wrong, each behind the preparation and, where measured, raw."""
    return join(
        _heat_map(findings, kind, variant, f"Map {number}.")
        for number, (kind, variant) in enumerate(_maps(findings), 1)
    )


def _maps(findings: Findings) -> list[tuple[str, str]]:
    """(kind, variant) in the order of the page."""
    variants = [name for name, pool in (("prepared", findings.prepared), ("raw", findings.raw)) if pool]
    return [(kind, variant) for kind in ("success", "wrong") for variant in variants]


def _heat_map(findings: Findings, kind: str, variant: str, number: str) -> Markup:
    pool = [each for each in (findings.tally(solver, variant) for solver in findings.solvers) if each is not None]
    solvers = [each.solver for each in pool]
    heads = [column_head("family", 0)]
    heads += [column_head(solver, column, class_="upright") for column, solver in enumerate(solvers, 1)]
    met = [family for family in findings.families if any((s, variant, family) in findings.cells for s in solvers)]
    shown = [family for family in met if kind == "success" or _is_wrong_anywhere(findings, variant, family)]
    rows = [
        [_family_head(family, order), *(_cell(kind, findings.cells.get((s, variant, family))) for s in solvers)]
        for order, family in enumerate(shown)
    ]
    lead, more, label = _words(kind, variant, len(met) - len(shown))
    total = [row_head(element("b", "all families")), *(_total(kind, each) for each in pool)]
    return table(caption(number, lead, more), [heads], rows, label=label, class_="heat", total=total)


def time_map(findings: Findings) -> Markup:
    """Time ratios behind the preparation."""
    pool = findings.prepared
    heads = [column_head("family", 0)]
    heads += [column_head(each.solver, column, class_="upright") for column, each in enumerate(pool, 1)]
    rows = []
    for order, family in enumerate(findings.families):
        cells = [findings.cells.get((each.solver, "prepared", family)) for each in pool]
        if any(cells):
            rows.append([_family_head(family, order), *(_pace(cell.time_ratio if cell else None) for cell in cells)])
    lead = (
        f"Time behind the preparation, as a ratio to {findings.context.default_solver}: geometric mean over a family."
    )
    more = "CPU time; failures counted at the time limit. The stronger the shade, the slower; full from 1000 on."
    total = [row_head(element("b", "all families")), *(_pace(each.time_ratio) for each in pool)]
    label = "Time ratio by family and solver"
    return table(
        caption(f"Map {len(_maps(findings)) + 1}.", lead, more), [heads], rows, label=label, class_="heat", total=total
    )


def _pace(ratio: float | None) -> Markup:
    """1 and below is the palest shade, 1000 and above the strongest, by the logarithm between."""
    if ratio is None:
        return element("td", NOTHING, class_="untaken", data_value="", title="not taken")
    share = math.log10(ratio) / 3.0 if ratio > 0.0 else 0.0
    return element("td", ratio_text(ratio), class_=f"time-{level(share)}", data_value=f"{ratio:.12g}")


def _is_wrong_anywhere(findings: Findings, variant: str, family: str) -> bool:
    cells = (findings.cells.get((solver, variant, family)) for solver in findings.solvers)
    return any(cell is not None and cell.silently_wrong for cell in cells)


def _words(kind: str, variant: str, left_out: int) -> tuple[str, Markup, str]:
    """Caption in two parts, and the short name."""
    words = _VARIANT_WORDS[variant]
    if kind == "success":
        lead = f"Success, {words}: percent of the problems of a family that a solver takes."
        flag = element("span", "▲2", class_="flag")
        more = join(["The stronger the blue, the more. ", flag, " counts silently wrong answers. Hatched: not taken."])
        return lead, more, f"Success by family and solver, {words}"
    lead = f"Silently wrong, {words}: percent of the problems taken that are claimed optimal and are not."
    text = "A dot is none: the best result. Hatched: not taken."
    if left_out:
        text += f" Left out: {left_out} families in which no solver is silently wrong."
    return lead, join([text]), f"Silently wrong by family and solver, {words}"


def _family_head(family: str, order: int) -> Markup:
    return row_head(element("a", family, href=f"#family-{family}"), value=order)


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
