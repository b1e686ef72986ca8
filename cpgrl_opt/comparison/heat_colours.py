"""Ramps of colours, for the light and for the dark page: blue for success, orange for silently wrong, grey for time.

Blue against orange stays apart under every common colour blindness, and lightness is monotone in every ramp, so that
a grey print orders the cells rightly too.
"""

from collections.abc import Sequence
from itertools import pairwise

LEVELS = 12  # 0: exactly none, 1…10: the tenths between, 11: exactly all

Colour = tuple[int, int, int]
Ramp = Sequence[tuple[float, str]]

_RAMPS: dict[tuple[str, str], Ramp] = {
    ("success", "light"): ((0.0, "#f7f5f0"), (0.3, "#d3e2ec"), (0.7, "#92bcd8"), (0.93, "#4f90bf"), (1.0, "#154f82")),
    ("success", "dark"): ((0.0, "#1b1d21"), (0.3, "#1d3446"), (0.7, "#23597f"), (0.93, "#2c6c98"), (1.0, "#5aa9db")),
    ("wrong", "light"): ((0.0, "#fbfaf7"), (0.1, "#fbdcc4"), (0.4, "#f0a26c"), (0.7, "#cf5a1b"), (1.0, "#7d2a05")),
    ("time", "light"): ((0.0, "#fbfaf7"), (0.5, "#b9b4c4"), (1.0, "#3f3a52")),
    ("time", "dark"): ((0.0, "#1b1d21"), (0.5, "#595468"), (1.0, "#d6d0e6")),
    ("wrong", "dark"): ((0.0, "#1b1d21"), (0.1, "#53290f"), (0.4, "#9c4717"), (0.7, "#e57d38"), (1.0, "#ffd0a8")),
}


def level(share: float) -> int:
    """0 for none, LEVELS − 1 for all, what lies between by tenths."""
    if share <= 0.0:
        return 0
    return LEVELS - 1 if share >= 1.0 else 1 + min(int(10 * share), 9)


def heat_styles() -> str:
    """CSS: the background and a text colour that can be read on it, per map, level and colour scheme."""
    light = _rules("light")
    return f"{light}\n@media (prefers-color-scheme: dark) {{\n{_rules('dark')}\n}}"


def _rules(scheme: str) -> str:
    lines = []
    for (name, of_scheme), ramp in _RAMPS.items():
        if of_scheme == scheme:
            for step in range(LEVELS):
                red, green, blue = colour = _colour(ramp, step / (LEVELS - 1))
                lines.append(f".{name}-{step}{{background:#{red:02x}{green:02x}{blue:02x};color:{_ink(colour)}}}")
    return "\n".join(lines)


def _colour(ramp: Ramp, share: float) -> Colour:
    """The ramp at a share, linear between its stops."""
    for (low, start), (high, end) in pairwise(ramp):
        if share <= high:
            weight = (share - low) / (high - low)
            red, green, blue = (
                round((1 - weight) * a + weight * b) for a, b in zip(_parse(start), _parse(end), strict=True)
            )
            return red, green, blue
    return _parse(ramp[-1][1])


def _parse(code: str) -> Colour:
    return int(code[1:3], 16), int(code[3:5], 16), int(code[5:7], 16)


def _ink(background: Colour) -> str:
    """Black or white, whichever has the higher WCAG contrast."""
    luminance = sum(w * _linear(c / 255) for w, c in zip((0.2126, 0.7152, 0.0722), background, strict=True))
    return "#fff" if 1.05 / (luminance + 0.05) > (luminance + 0.05) / 0.05 else "#000"


def _linear(channel: float) -> float:
    return channel / 12.92 if channel <= 0.04045 else ((channel + 0.055) / 1.055) ** 2.4
