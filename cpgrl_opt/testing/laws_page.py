"""The laws of the conformance kit as Markdown, one paragraph each, from their docstrings."""

import inspect
import sys

from .laws import LAWS, Law


def to_markdown() -> str:
    """docs/laws.md."""
    return "\n\n".join([_INTRODUCTION, *(_section(law) for law in LAWS.values())]) + "\n"


def _section(law: Law) -> str:
    text = inspect.cleandoc(law.check.__doc__ or "")
    return f"## {law.name.removeprefix('check_').replace('_', ' ')}\n\n```text\n{text}\n```"


_INTRODUCTION = """# The laws of the conformance kit

Made by `python -m cpgrl_opt.testing.laws_page > docs/laws.md` from the docstrings of the laws; a test holds it to
them. `cpgrl check` puts a solver to all laws that its `supports` and its declarations let it take
([your own solver](your_own_solver.md)).

p(g) is the solver's direction for the gradient g and ε its tolerance. Rows in E are equalities, those in I are not.
Ĵᵢ = Jᵢ/‖Jᵢ‖, b̂ᵢ = bᵢ/‖Jᵢ‖, σ = max(‖g‖, ‖d‖). H is Hoffman's constant of the rows, about 1/angle for rows that nearly
depend."""

if __name__ == "__main__":
    sys.stdout.reconfigure(encoding="utf-8")  # type: ignore[union-attr]
    sys.stdout.write(to_markdown())
