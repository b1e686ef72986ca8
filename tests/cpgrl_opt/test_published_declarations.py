"""Each published method's declaration against what the kit measures, in both directions; and the table in the docs."""

from pathlib import Path

import pytest

from cpgrl_opt import DirectionProblem
from cpgrl_opt.published import PUBLISHED
from cpgrl_opt.testing import LAWS, LawError
from cpgrl_opt.testing.examination import first_break
from cpgrl_opt.testing.published_table import speaks_about, to_markdown

SPOKEN = [(name, law) for name, method in PUBLISHED.items() for law in LAWS if speaks_about(LAWS[law], method)]
HELD = [pair for pair in SPOKEN if pair[1] not in PUBLISHED[pair[0]].declaration.broken]
BROKEN = [(name, law) for name, method in PUBLISHED.items() for law in method.declaration.broken]


def sampled(pairs, step):
    """All pairs; those between every `step`-th are slow."""
    return [pytest.param(*pair, marks=[pytest.mark.slow] if k % step else []) for k, pair in enumerate(pairs)]


# For laws that few problems break.
EXAMPLES = {
    ("crpo", "check_permutation"): {
        "problem": DirectionProblem([1.0, 0.0], [[1.0, 0.0], [0.0, 1.0]], [1.0, 1.0]),
        "order": [1, 0],
    },
    ("mgda", "check_non_expansiveness"): {
        "problem": DirectionProblem([4.0, -3.0], [[3.0, -4.0]]),
        "other": [4.0, -3.25],
    },
    ("mgda", "check_firm_non_expansiveness"): {
        "problem": DirectionProblem([4.0, -3.0], [[3.0, -4.0]]),
        "other": [4.0, -3.25],
    },
}


def what_breaks(name, law_name, max_examples):
    return first_break(LAWS[law_name], PUBLISHED[name], max_examples=max_examples)


@pytest.mark.parametrize(("name", "law"), sampled(BROKEN, 3))
def test_a_law_that_is_declared_broken_is_broken(name, law):
    if (name, law) in EXAMPLES:
        with pytest.raises(LawError):
            LAWS[law].check(PUBLISHED[name], **EXAMPLES[name, law])
    else:
        assert what_breaks(name, law, 300).broken


@pytest.mark.parametrize(("name", "law"), sampled(HELD, 5))
def test_a_law_that_is_not_declared_broken_holds(name, law):
    found = what_breaks(name, law, 5)
    assert not found.broken, found.message
    assert found.held


@pytest.mark.slow
@pytest.mark.parametrize(("name", "law"), HELD)
def test_it_holds_on_many_problems(name, law):
    found = what_breaks(name, law, 500)
    assert not found.broken, found.message
    assert found.held > 50


@pytest.mark.parametrize("name", PUBLISHED)
def test_what_is_declared_broken_is_a_law_about_the_method_and_has_a_reason(name):
    broken = PUBLISHED[name].declaration.broken
    assert [pair for pair in SPOKEN if pair[0] == name]
    assert set(broken) <= {law for key, law in SPOKEN if key == name}
    assert all(reason.strip() and not reason.endswith(".") for reason in broken.values())


def test_the_table_in_the_docs_is_that_of_the_declarations():
    """And it marks what a method breaks, holds and is silent about."""
    docs = Path(__file__).parents[2] / "docs" / "published.md"
    text = to_markdown()
    command = "python -m cpgrl_opt.testing.published_table > docs/published.md"
    assert docs.read_text(encoding="utf-8") == text, command
    assert "| law | CPO | PCPO | CRPO | GEM | A-GEM | PCGrad | MGDA | UPGrad |" in text
    assert "| row scaling | ✓ | ✓ | ✗ | ✓ | ✗ | ✗ | ✗ | ✗ |" in text
    assert "| inactive row | – | – | ✓ | ✓ | ✗ | ✗ | ✗ | ✗ |" in text
