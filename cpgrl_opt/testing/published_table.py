"""The table method × law as Markdown, from the methods' declarations; the tests hold these to what the kit measures."""

import sys

from ..published import PUBLISHED
from ..published.interface import Declaration, PublishedMethod
from .laws import LAWS, Law

HOLDS, BREAKS, SILENT = "✓", "✗", "–"


def speaks_about(law: Law, method: PublishedMethod) -> bool:
    """Whether the law says anything about the problems that the method takes."""
    return bool(law.applies_to(method))


def to_markdown() -> str:
    """docs/published.md: the table, then each method with its formula, problem, source and what it breaks."""
    methods = list(PUBLISHED.values())
    head = " | ".join(method.declaration.name for method in methods)
    rows = [
        f"| {law.name.removeprefix('check_').replace('_', ' ')} | {' | '.join(_mark(law, each) for each in methods)} |"
        for law in LAWS.values()
        if any(speaks_about(law, method) for method in methods)
    ]
    table = "\n".join([f"| law | {head} |", f"|---|{':-:|' * len(methods)}", *rows])
    return (
        "\n\n".join([_INTRODUCTION, table, *(_section(name, PUBLISHED[name].declaration) for name in PUBLISHED)]) + "\n"
    )


def _mark(law: Law, method: PublishedMethod) -> str:
    if not speaks_about(law, method):
        return SILENT
    return BREAKS if law.name in method.declaration.broken else HOLDS


def _section(name: str, declared: Declaration) -> str:
    lines = [
        f"## {declared.name} (`{name}`)",
        f"{declared.formula}. Source: {declared.source}.",
        f"Solves: {declared.problem}.",
    ]
    broken = [f"- `{check}`: {reason}." for check, reason in declared.broken.items()]
    return "\n\n".join([*lines, *(["\n".join(["Breaks:", "", *broken])] if broken else [])])


_INTRODUCTION = f"""# Published methods and the laws of the conformance kit

Made by `python -m cpgrl_opt.testing.published_table > docs/published.md` from the declarations in
`cpgrl_opt/published/`; the tests put every method to every law, and a declaration that is wrong in either direction
fails them.

{HOLDS} holds, {BREAKS} breaks, {SILENT} says nothing about the problems that the method takes. A broken law is no fault
where the method solves another problem than ours: it says in what the two differ. g is the ascent gradient of the
objective, the rows of J those of the constraints; CPO and PCPO take problems with a radius and one constraint, the
others J d ≥ 0 (CRPO J d ≥ b). Methods without multipliers get those that suit their direction best, so that dual
feasibility holds of itself, and complementarity where no constraint is violated."""

if __name__ == "__main__":
    sys.stdout.reconfigure(encoding="utf-8")  # type: ignore[union-attr]
    sys.stdout.write(to_markdown())
