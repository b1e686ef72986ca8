"""Performance profiles as inline SVG: one figure of all solvers, and one small panel for each."""

import math
from collections.abc import Mapping, Sequence

from .findings import Findings
from .markup import Markup, element, join
from .profiles import Key, Profile
from .wording import percent_text

_COLOURS = 7
_WIDTH, _HEIGHT = 880.0, 420.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 168.0, 12.0, 44.0
_LABEL_GAP = 15.0


class _Axes:
    """Where τ ≥ 1 (logarithmic) and a share stand on paper."""

    def __init__(self, box: tuple[float, float, float, float], decades: int) -> None:
        self.left, self.top, self.right, self.bottom = box
        self.decades = decades

    def x(self, factor: float) -> float:
        return self.left + (self.right - self.left) * min(math.log10(factor) / self.decades, 1.0)

    def y(self, share: float) -> float:
        return self.bottom - (self.bottom - self.top) * share

    def curve(self, profile: Profile) -> str:
        """The step function as a path; of the steps within half a pixel the last counts."""
        corners: dict[float, float] = {self.left: self.bottom}
        for factor, share in zip(profile.factors, profile.shares, strict=True):
            if math.log10(factor) <= self.decades:
                corners[round(2 * self.x(factor)) / 2] = self.y(share)
        points = list(corners.items())
        steps = [f"H{_short(x)}V{_short(y)}" for x, y in points[1:]]
        return f"M{_short(points[0][0])} {_short(points[0][1])}" + "".join(steps) + f"H{_short(self.right)}"


def _short(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")


def decades_of(profiles: Mapping[Key, Profile]) -> int:
    """Powers of ten that the axis of τ needs."""
    last = max((profile.factors[-1] for profile in profiles.values() if profile.factors), default=10.0)
    return max(1, math.ceil(math.log10(last) - 1e-9))


def overview(findings: Findings) -> Markup:
    """All solvers behind the preparation in one figure, each named at its end."""
    profiles = findings.profiles
    axes = _Axes((_LEFT, _TOP, _WIDTH - _RIGHT, _HEIGHT - _BOTTOM), decades_of(profiles))
    keys = sorted(profiles, key=lambda key: (-profiles[key].at(math.inf), -profiles[key].at(1.0), key))
    curves = [
        element("path", d=axes.curve(profiles[key]), class_=f"curve {_style(rank)}") for rank, key in enumerate(keys)
    ]
    names = ", ".join(f"{solver} {percent_text(100 * profiles[solver, v].at(math.inf))} %" for solver, v in keys)
    title = f"Performance profiles; share solved in the end: {names}"
    return element(
        "svg", element("title", title), _grid(axes, 12), *curves, _labels(axes, keys, profiles),
        viewbox=f"0 0 {_WIDTH:g} {_HEIGHT:g}", role="img", class_="overview", aria_label=title,
    )  # fmt: skip


def _style(rank: int) -> str:
    return f"ink-{rank % _COLOURS}" + (" dashed" if rank // _COLOURS % 2 else "")


def _labels(axes: _Axes, keys: Sequence[Key], profiles: Mapping[Key, Profile]) -> Markup:
    """Names at the right, in the order of the curves' ends, moved apart, with a line to where each belongs."""
    ends = [axes.y(profiles[key].at(10.0**axes.decades)) for key in keys]
    places = _spread(ends, axes.top + 4, axes.bottom)
    found = []
    for rank, (key, end, place) in enumerate(zip(keys, ends, places, strict=True)):
        line = f"M{_short(axes.right)} {_short(end)}L{_short(axes.right + 14)} {_short(place)}h6"
        found.append(element("path", d=line, class_=f"leader {_style(rank)}"))
        share = percent_text(100 * profiles[key].at(math.inf))
        found.append(element("text", f"{key[0]} {share} %", x=_short(axes.right + 24), y=_short(place + 4)))
    return element("g", *found, class_="labels", aria_hidden="true")


def _spread(wanted: Sequence[float], top: float, bottom: float) -> list[float]:
    """Increasing places at least _LABEL_GAP apart, near the wanted increasing ones, within [top, bottom] if it fits."""
    places: list[float] = []
    for want in wanted:
        places.append(max(want, places[-1] + _LABEL_GAP if places else top))
    limit = bottom
    for index in range(len(places) - 1, -1, -1):
        places[index] = min(places[index], limit)
        limit = places[index] - _LABEL_GAP
    return places


def _grid(axes: _Axes, size: int) -> Markup:
    """Axes with their ticks and units."""
    every = max(1, math.ceil(axes.decades / (6 if size > 11 else 3)))
    parts = []
    for power in range(0, axes.decades + 1, every):
        x = _short(axes.x(10.0**power))
        parts.append(element("path", d=f"M{x} {_short(axes.top)}V{_short(axes.bottom)}", class_="grid"))
        parts.append(element("text", _power(power), x=x, y=_short(axes.bottom + size + 4), text_anchor="middle"))
    for share in (0.0, 0.5, 1.0) if size <= 11 else (0.0, 0.2, 0.4, 0.6, 0.8, 1.0):
        y = axes.y(share)
        parts.append(element("path", d=f"M{_short(axes.left)} {_short(y)}H{_short(axes.right)}", class_="grid"))
        parts.append(element("text", f"{100 * share:.0f}", x=_short(axes.left - 6), y=_short(y + 4), text_anchor="end"))
    if size > 11:
        middle = (axes.left + axes.right) / 2
        parts.append(
            element(
                "text", "time / time of the fastest, τ", x=_short(middle), y=_short(_HEIGHT - 6), text_anchor="middle"
            )
        )
        half = _short((axes.top + axes.bottom) / 2)
        parts.append(
            element("text", "problems solved, %", transform=f"translate(11 {half}) rotate(-90)", text_anchor="middle")
        )
    return element("g", *parts, class_="axes", aria_hidden="true")


def _power(power: int) -> str:
    digits = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
    return ("1", "10", "100")[power] if power < 3 else "10" + str(power).translate(digits)


def panels(findings: Findings) -> Markup:
    """A panel for each solver: its own curves before those of all the others in grey."""
    axes = _Axes((24.0, 6.0, 176.0, 96.0), decades_of(findings.common))
    others = [
        element("path", d=axes.curve(profile))
        for (_, variant), profile in findings.common.items()
        if variant == "prepared"
    ]
    field = element("g", _grid(axes, 11), element("g", *others, class_="others"), id="field", class_="field")
    definitions = element("defs", field)
    shared = element("svg", definitions, width="0", height="0", class_="shared", aria_hidden="true")
    found = [_panel(axes, solver, findings.common) for solver in findings.solvers]
    return join([shared, element("div", *found, class_="panels")])


def _panel(axes: _Axes, solver: str, profiles: Mapping[Key, Profile]) -> Markup:
    own = [(variant, profiles[solver, variant]) for variant in ("raw", "prepared") if (solver, variant) in profiles]
    curves = [element("path", d=axes.curve(profile), class_=f"own {variant}") for variant, profile in own]
    words = ", ".join(f"{variant} {percent_text(100 * profile.at(math.inf))} %" for variant, profile in reversed(own))
    drawing = element("svg", element("use", href="#field"), *curves, viewbox="0 0 190 114", role="img",
                      aria_label=f"{solver}: share solved in the end: {words}")  # fmt: skip
    return element(
        "figure", drawing, element("figcaption", element("b", solver), element("span", words)), class_="panel"
    )
