"""The comparison as two documents for people, report.md and report.html, from the table of measurements.

One template, `report.jinja`, says what stands where; here are the numbers and the figure that it shows.
"""

import base64
import io
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import markdown_text
from .choice import RULE, Choice, choose
from .measurement import AS_BYTES, Measurement
from .table import UNSAFE, as_table, count, profiles, rank, readable, taken_by_both
from .whole_file import whole_file

if TYPE_CHECKING:
    import pandas as pd

NOTHING = "–"
FAR = 1e-6  # relative distance from the exact direction
_OUTCOMES = ("success", "inaccurate", "silently-wrong", "honest-failure", "false-infeasible", "missed-infeasible")


@dataclass(frozen=True, kw_only=True)
class ReportContext:
    """How the measurements came about.

    command: what to type to get them again; machine, versions, settings: name → value, shown in this order (seconds
    limits with their unit in the name); families: name → the reason it exists, in the order to show; wall_seconds: of
    the whole comparison; default_solver: whose time is 1; ill_posed: families of which float64 does not determine the
    direction, so that distances from the exact one are told apart from the others.
    """

    command: str
    machine: Mapping[str, object]
    versions: Mapping[str, object]
    settings: Mapping[str, object]
    families: Mapping[str, str]
    seed: int
    wall_seconds: float
    default_solver: str = "active-set"
    ill_posed: Collection[str] = ()


@dataclass(frozen=True)
class Table:
    """Rows of text below a heading, the first column names; colours: of cells, by their place, in HTML only."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    colours: Mapping[tuple[int, int], str] = field(default_factory=dict)


def write_report(measurements: Sequence[Measurement], context: ReportContext, folder: Path) -> tuple[Path, Path]:
    """report.md and report.html in `folder`, which is made where missing; the same bytes for the same input."""
    told = {readable(name): reason for name, reason in context.families.items()}
    context = replace(context, families=told, ill_posed=set(map(readable, context.ill_posed)))
    shown = _contents(as_table(measurements), context)
    folder.mkdir(parents=True, exist_ok=True)
    paths = folder / "report.md", folder / "report.html"
    for path in paths:
        with whole_file(path) as beside:
            text = _render(is_html=path.suffix == ".html", **shown)
            beside.write_text(text, encoding="utf-8", errors=AS_BYTES, newline="\n")
    return paths


def print_summary(measurements: Sequence[Measurement]) -> None:
    """The main table on a terminal: success, silently wrong, and time of each solver, prepared and raw."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table as Lines

    lines = Lines(title="prepared | raw: the library alone, on small problems")
    for name in ("solver", "variant", "problems", "success %", "silently wrong %", "time ×"):
        lines.add_column(name, justify="left" if name in ("solver", "variant") else "right")
    for row in _main_table(as_table(measurements), ()).rows:
        lines.add_row(*map(escape, (row[0], row[1], row[2], row[3], row[5], row[-1])))
    Console().print(lines)


def _render(*, is_html: bool, **shown: Any) -> str:
    from jinja2 import Environment, StrictUndefined

    made = Environment(autoescape=is_html, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    as_is: Callable[[str], str] = str
    made.filters["text"] = as_is if is_html else markdown_text.text
    made.filters["name"] = as_is if is_html else markdown_text.code
    made.filters["block"] = as_is if is_html else markdown_text.block
    source = files(__package__).joinpath("report.jinja").read_text(encoding="utf-8")
    return re.sub("\n{3,}", "\n\n", made.from_string(source).render(is_html=is_html, **shown)).strip() + "\n"


def _contents(table: "pd.DataFrame", context: ReportContext) -> dict[str, Any]:
    met = table["family"].unique()
    order = [name for name in dict.fromkeys((*context.families, *met)) if name in set(met)]
    has = {variant: bool((table["variant"] == variant).any()) for variant in ("prepared", "raw")}
    prepared = table[table["variant"] == "prepared"]
    maps = [
        (kind, variant, _map(table[table["variant"] == variant], order, kind))
        for kind in ("success %", "silently wrong %", "time ratio")
        for variant in ("prepared", "raw")
        if has[variant]
    ]
    return {
        "context": context,
        "asked": (table["solver"].nunique(), len(table.groupby(["family", "problem"])), len(order), len(table)),
        "choice": _choice_sentences(choose(table), table, context.default_solver),
        "rule": RULE,
        "main": _main_table(table, context.ill_posed),
        "astray": _astray_table(prepared, context.ill_posed, order),
        "gains": _gain_table(table) if all(has.values()) else None,
        "maps": maps,
        "families": _family_table(table, order, context.families),
        "profile": _profile_figure(prepared) if has["prepared"] else "",
    }


def _main_table(table: "pd.DataFrame", ill_posed: Collection[str]) -> Table:
    """A row for each solver and variant, the prepared first, the best first."""
    rows = []
    for variant in ("prepared", "raw"):
        counts = rank(count(table[table["variant"] == variant], ["solver"], ill_posed))
        for solver, own in counts.to_dict("index").items():
            shares = [percent_text(_share(own, outcome)) for outcome in _OUTCOMES]
            numbers = [str(own[name]) for name in ("hang", "crash", "noise")]
            far = [distance_text(own[name]) for name in ("distance", "ill_posed")]
            rows.append([str(solver), variant, str(own["taken"]), *shares, *numbers, *far, ratio_text(own["time"])])
    words = (f"{outcome.replace('-', ' ')} %" for outcome in _OUTCOMES)
    last = ("hangs", "crashes", "noise", "distance", "distance, ill-posed", "time ratio")
    return Table(("solver", "variant", "problems", *words, *last), rows)


def _share(counts: Any, outcome: str) -> float:
    return float(100.0 * counts[outcome] / counts["taken"]) if counts["taken"] else math.nan


def _success_text(counts: Any) -> str:
    return percent_text(_share(counts, "success"))


def _map(table: "pd.DataFrame", order: Sequence[str], kind: str) -> Table:
    """Family × solver, the best solver first, with a line over all families on top."""
    whole = rank(count(table, ["solver"])).to_dict("index")
    cells = count(table, ["family", "solver"]).to_dict("index")
    cells |= {("all families", solver): own for solver, own in whole.items()}
    text, value, colour = _MAPS[kind]
    rows, colours, met = [], dict[tuple[int, int], str](), set(table["family"])
    for place, family in enumerate(("all families", *(name for name in order if name in met))):
        found = [cells.get((family, solver)) for solver in whole]
        numbers = [value(own) if own and own["taken"] else math.nan for own in found]
        rows.append([family, *map(text, numbers)])
        colours |= {(place, k): colour(number) for k, number in enumerate(numbers, 1) if number == number}
    return Table(("family", *whole), rows, colours)


def _colour(name: str, most: float, value: float) -> str:
    return _shade(name, round(60 * min(max(value / most, 0.0), 1.0)))


@cache
def _shade(name: str, percents: int) -> str:
    """Of the pale part of a colour map of matplotlib, on which black is read."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return to_hex(colormaps[name](percents / 100))


def _astray_table(prepared: "pd.DataFrame", ill_posed: Collection[str], order: Sequence[str]) -> Table | None:
    """Certified, yet far from the exact direction, on families of which float64 does not determine it."""
    known = prepared[(prepared["outcome"] == "success") & prepared["distance"].notna()]
    rows = []
    for family in order:
        far = known.loc[known["family"] == family, "distance"]
        if family in set(ill_posed) and len(far):
            rows.append([family, str(len(far)), str(int((far > FAR).sum())), distance_text(far.max())])
    return Table(("family", "certified", "farther than 1e-6", "largest"), rows) if rows else None


def _gain_table(table: "pd.DataFrame") -> Table | None:
    """The same problems raw and behind the preparation, the greatest gain first."""
    both = taken_by_both(table)
    if not len(both):
        return None
    counts = count(both, ["solver", "variant"]).to_dict("index")
    pairs = {solver: [counts[solver, variant] for variant in ("raw", "prepared")] for solver in both["solver"].unique()}
    gain = {solver: _share(prepared, "success") - _share(raw, "success") for solver, (raw, prepared) in pairs.items()}
    rows = []
    for solver in sorted(pairs, key=lambda name: (-gain[name], name)):
        success, unsafe = ([of(own) for own in pairs[solver]] for of in (_success_text, unsafe_text))
        rows.append([solver, str(pairs[solver][0]["problems"]), *success, *unsafe, f"{gain[solver]:+.1f}"])
    words = (f"{what} {variant}" for what in ("success %", "unsafe") for variant in ("raw", "prepared"))
    return Table(("solver", "problems", *words, "gain, points"), rows)


def _family_table(table: "pd.DataFrame", order: Sequence[str], reasons: Mapping[str, str]) -> Table:
    """Why each family is there, and who solves all of it."""
    cells = count(table[table["variant"] == "prepared"], ["family", "solver"]).to_dict("index")
    pooled = count(table, ["family", "variant"]).to_dict("index")
    rows = []
    for family in order:
        taking = {solver: own for (name, solver), own in cells.items() if name == family and own["taken"]}
        times = {solver: own["time"] for solver, own in taking.items() if own["success"] == own["problems"]}
        fastest = min(times, key=times.__getitem__, default="")
        both = [pooled.get((family, variant)) for variant in ("prepared", "raw")]
        problems = str(table.loc[table["family"] == family, "problem"].nunique())
        success = " / ".join(_success_text(own) if own else NOTHING for own in both)
        wrong = " / ".join(str(own["silently-wrong"]) if own else NOTHING for own in both)
        fastest = f"{fastest} ({ratio_text(times[fastest])})" if times else NOTHING
        told = problems, f"{len(times)} of {len(taking)}", success, wrong, fastest
        rows.append([family, reasons.get(family, ""), *told])
    words = ("why it is there", "problems", "solved by", "success %", "silently wrong", "fastest that solves all")
    return Table(("family", *words), rows)


def _choice_sentences(choice: Choice, table: "pd.DataFrame", default_solver: str) -> list[str]:
    if not choice.first:
        return ["No solver was measured behind the preparation, so there is none to recommend."]
    counts = count(table[table["variant"] == "prepared"], ["solver"]).to_dict("index")
    merits = partial(_merits, counts, default_solver)
    found = [f"Choose {choice.first}: {merits(choice.first)}."]
    if choice.second:
        found.append(f"To check it by another method: {choice.second}: {merits(choice.second)}.")
    found += [
        f"Where every problem is one that it takes ({', '.join(each.families)}), {each.solver} solves all, in "
        f"{ratio_text(each.time)} × {default_solver}'s time against {choice.first}'s {ratio_text(each.choice_time)} ×."
        for each in choice.specialists
    ]
    return found


def _merits(counts: Mapping[Any, Any], default_solver: str, solver: str) -> str:
    own = counts[solver]
    pace = f"{ratio_text(own['time'])} × {default_solver}'s time, failures counted at the limit"
    if solver == default_solver:
        pace = "the solver to whose time all others' are ratios"
    solved = f"{_success_text(own)} % success on {own['taken']} of {own['problems']} problems"
    return f"{solved}, {unsafe_text(own, none='no unsafe answer')}, {pace}"


def _profile_figure(prepared: "pd.DataFrame") -> str:
    """Performance profiles, a PNG in base 64."""
    import matplotlib
    from matplotlib.figure import Figure

    curves = sorted(profiles(prepared).items(), key=lambda item: (-item[1][1][-1] if len(item[1][1]) else 0.0, item[0]))
    last = max([10.0, *(factors[-1] for _, (factors, _) in curves if len(factors))])
    with matplotlib.rc_context(matplotlib.rcParamsDefault):  # whatever the user's matplotlibrc says
        figure = Figure(figsize=(9, 5), dpi=150, layout="constrained")
        axes = figure.add_subplot(xscale="log", xlim=(1, 1.1 * last), ylim=(0, 102))
        axes.set_xlabel("τ, CPU time over the fastest solver's")
        axes.set_ylabel("problems solved within τ, %")
        for number, (solver, (factors, shares)) in enumerate(curves):
            steps = [1.0, *factors, 1.1 * last], [0.0, *(100 * shares), 100 * shares[-1] if len(shares) else 0.0]
            style = ("-", "--", ":")[number // 7 % 3]
            label = f"{solver} {percent_text(steps[1][-1])} %".replace("$", r"\$")
            axes.step(*steps, where="post", color=f"C{number % 7}", linestyle=style, label=label)
        axes.grid(alpha=0.3)
        figure.legend(loc="outside right upper", fontsize="small")
        drawn = io.BytesIO()
        figure.savefig(drawn, format="png", metadata={"Software": None})
    return base64.b64encode(drawn.getvalue()).decode()


def percent_text(value: float, digits: int = 1) -> str:
    """A percentage, rounded, but only all reads 100 and only none reads 0; – for NaN."""
    if value != value:
        return NOTHING
    if value in (0.0, 100.0):
        return f"{value:.0f}"
    unit = 10.0**-digits
    return f"<{unit:.{digits}f}" if value < unit else f"{min(value, 100.0 - unit):.{digits}f}"


def ratio_text(value: float) -> str:
    """A time ratio to two figures, whole numbers from 10 on; – for NaN."""
    if value != value:
        return NOTHING
    return f"{value:.2g}" if value < 10 else f"{float(f'{value:.3g}'):,.0f}".replace(",", "\u202f")


def distance_text(value: float) -> str:
    """A relative distance to one figure; – for NaN."""
    return NOTHING if value != value else f"{value:.0e}" if value else "0"


def unsafe_text(counts: Any, none: str = "0") -> str:
    """Unsafe answers by kind."""
    kinds = [f"{outcome.replace('-', ' ')} {counts[outcome]}" for outcome in UNSAFE if counts[outcome]]
    return ", ".join(kinds) or none


def _percents(value: float) -> str:
    return percent_text(value, 0)


# Of each map: the text of a number, the number of some counts, the colour of a number.
_MAPS: Mapping[str, tuple[Callable[[float], str], Callable[[Any], float], Callable[[float], str]]] = {
    "success %": (_percents, lambda own: _share(own, "success"), partial(_colour, "Greens", 100.0)),
    "silently wrong %": (
        _percents,
        lambda own: _share(own, "silently-wrong"),
        partial(_colour, "Reds", 100.0),
    ),
    "time ratio": (
        ratio_text,
        lambda own: own["time"],
        lambda time: _colour("Blues", 4.0, math.log10(max(time, 1.0))),
    ),
}
