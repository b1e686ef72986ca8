"""HTML by function calls: what is not markup already is escaped, so that no text can become a tag."""

from collections.abc import Iterable
from html import escape

_VOID = ("meta",)
_BLOCKS = (
    "section",
    "tr",
    "thead",
    "tbody",
    "figure",
    "table",
    "div",
    "p",
    "h2",
    "h3",
    "ul",
    "ol",
    "li",
    "svg",
    "path",
)


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


def element(tag: str, *children: str | None, **attributes: object) -> Markup:
    """<tag attribute="…">children</tag>.

    Children that are not Markup are escaped, None is left out. Of attributes, class_ is written class, data_value
    data-value; True stands for a bare name, None and False for nothing.
    """
    opening = tag + "".join(_attribute(name, value) for name, value in attributes.items())
    end = "\n" if tag in _BLOCKS else ""
    if tag in _VOID:
        return Markup(f"<{opening}>\n")
    return Markup(f"<{opening}>{join(children)}</{tag}>{end}")


def join(children: Iterable[str | None]) -> Markup:
    """One after the other."""
    return Markup("".join(text_of(child) for child in children if child is not None))


def text_of(child: str) -> Markup:
    """Escaped, unless it is Markup."""
    return child if isinstance(child, Markup) else Markup(escape(child))


def _attribute(name: str, value: object) -> str:
    if value is None or value is False:
        return ""
    name = name.rstrip("_").replace("_", "-").replace("viewbox", "viewBox")
    return f" {name}" if value is True else f' {name}="{escape(str(value))}"'
