"""Tables that scroll inside their own box, keep their first column in sight, and can be sorted."""

from collections.abc import Sequence

from .markup import Markup, element, join


def number_cell(text: str, value: float | None, class_: str | None = None, note: str | None = None) -> Markup:
    """A figure; sorted by its value, not by its text. Without a value it stands last."""
    return element("td", text, class_=class_, data_value="" if value is None else f"{value:.12g}", title=note)


def text_cell(*children: str, class_: str = "words") -> Markup:
    """Words, which are sorted by the alphabet."""
    return element("td", *children, class_=class_)


def row_head(*children: str, id_: str | None = None, value: float | None = None) -> Markup:
    """The name of a row, which stays in sight."""
    return element("th", *children, scope="row", id=id_, data_value=None if value is None else f"{value:g}")


def column_head(title: str, column: int, note: str | None = None, class_: str | None = None) -> Markup:
    """The name of a column, by which rows can be sorted."""
    return element("th", element("span", title), scope="col", data_column=column, title=note, class_=class_)


def group_head(title: str, columns: int, note: str | None = None) -> Markup:
    """The name of several columns."""
    return element("th", title, scope="colgroup", colspan=columns, title=note, class_="group")


def column_heads(titles: Sequence[str], words: Sequence[str] = ()) -> list[Markup]:
    """A head for each title; those of `words` stand above words."""
    return [column_head(title, place, class_="words" if title in words else None) for place, title in enumerate(titles)]


def table(
    caption: Markup,
    heads: Sequence[Sequence[Markup]],
    rows: Sequence[Sequence[Markup]],
    *,
    label: str,
    class_: str = "",
    total: Sequence[Markup] = (),
) -> Markup:
    """The table in its box, under its caption.

    label: a short name, told to those who cannot see; total: a row that stays on top however the others are sorted.
    """
    head = element("thead", *(element("tr", *cells) for cells in heads))
    above = element("tbody", element("tr", *total), class_="total") if total else None
    body = element("tbody", *(element("tr", *cells) for cells in rows))
    inner = element("table", head, above, body, class_=f"sortable {class_}".strip(), aria_label=label)
    box = element("div", inner, class_="scroll", tabindex="0", role="region", aria_label=f"{label} (scrolls)")
    return element("figure", element("figcaption", caption), box, class_="table")


def simple_table(pairs: Sequence[tuple[str, str]], label: str) -> Markup:
    """name → value, one a row."""
    rows = [element("tr", row_head(name), text_cell(value)) for name, value in pairs]
    inner = element("table", element("tbody", *rows), class_="pairs", aria_label=label)
    return element("div", inner, class_="scroll", tabindex="0", role="region", aria_label=f"{label} (scrolls)")


def caption(number: str, sentence: str, more: str = "") -> Markup:
    """Table 1. What one sees. And how to read it."""
    return join([element("b", number), " ", element("span", sentence, class_="lead"), " ", more])
