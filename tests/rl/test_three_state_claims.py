"""Claims judged on made-up learning curves: each holds where the paper's picture is drawn and fails where it is not."""

import io
import json

import numpy as np
import pytest
from rich.console import Console

from rl.experiments.bootstrap import spread
from rl.experiments.claims import Claim, print_claims, write_claims
from rl.experiments.three_state.claims import STATEMENTS, Evidence
from rl.experiments.three_state.curves import LearningCurves

EPISODES = np.arange(0, 10_001, 100)
NO_THRESHOLDS = np.zeros(3)


def curves(final, policy, deviation, start=(0.35, -0.05, 0.03, 0.02), time=400.0):
    """Six runs that go exponentially from `start` to `final`, apart by `deviation`."""
    rng = np.random.default_rng(1)
    decay = np.exp(-EPISODES / time)[:, None]
    exact = np.asarray(start) * decay + np.asarray(final) * (1 - decay)
    scatter = deviation * rng.standard_normal((6, len(EPISODES), 4))
    policies = np.broadcast_to(np.asarray(policy), (6, len(EPISODES), 3, 3))
    return LearningCurves(EPISODES, exact + scatter, exact + scatter / 4, policies)


A1 = [[0.98, 0.01, 0.01]] * 3
CPGRL = curves([0.99, 0, 0, 0], A1, 0.001)
CONB = curves([0.3, 0, 0, 0], [[0.45, 0.5, 0.05]] * 3, 0.01, time=2000.0)
SUM = curves([1.7, 0.74, -0.74, 0], [A1[0], [0, 0, 1], [0.7, 0.3, 0]], 0.02)
OPTIMUM = np.array([1.0, 0, 0, 0])


def verdicts(cpgrl=CPGRL, conb=CONB, sum_=SUM, share=0.0):
    evidence = Evidence({"cpgrl": cpgrl, "conb": conb, "sum": sum_}, OPTIMUM, NO_THRESHOLDS, share)
    return {claim.id: claim.holds for claim in STATEMENTS.judge(evidence)}


def test_the_papers_picture_fulfils_all_but_the_claim_that_our_transitions_contradict():
    assert {name for name, holds in verdicts().items() if not holds} == {"all-choose-a1-in-s1"}


@pytest.mark.parametrize(
    ("changed", "failing"),
    [
        ({"cpgrl": SUM}, {"cpgrl-satisfies-constraints-early", "sum-best-r1", "cpgrl-chooses-a1-everywhere"}),
        ({"cpgrl": CONB}, {"cpgrl-reaches-optimum", "conb-takes-longer", "conb-spreads-more"}),
        ({"conb": CPGRL}, {"conb-fails-to-maximise", "conb-and-sum-inappropriate-in-s2-s3", "conb-takes-longer"}),
        ({"conb": SUM}, {"conb-satisfies-constraints", "conb-fails-to-maximise", "sum-best-r1"}),
        ({"sum_": CPGRL}, {"sum-violates-r3", "sum-best-r1", "sum-chooses-a3-in-s2"}),
        ({"cpgrl": curves([0.99, 0, 0, 0], A1, 0.2)}, {"cpgrl-spread-small", "conb-spreads-more"}),
        ({"cpgrl": curves([0.9, 0, 0, 0], A1, 0.001)}, {"cpgrl-reaches-optimum"}),
        ({"share": 0.2}, {"conb-rarely-follows-r1"}),
    ],
)
def test_each_claim_fails_where_its_curves_are_another_methods(changed, failing):
    failed = {name for name, holds in verdicts(**changed).items() if not holds}
    assert failing <= failed


def test_a_claim_about_spread_does_not_hold_of_a_single_run():
    single = {
        name: LearningCurves(c.episodes, c.estimated[:1], c.exact[:1], c.policies[:1])
        for name, c in (("cpgrl", CPGRL), ("conb", CONB), ("sum_", SUM))
    }
    held = verdicts(**single)
    assert not held["conb-spreads-more"]
    assert not held["cpgrl-spread-small"]


def test_the_claim_about_cpgrls_spread_says_which_averages_it_is_judged_by():
    evidence = Evidence({"cpgrl": CPGRL, "conb": CONB, "sum": SUM}, OPTIMUM, NO_THRESHOLDS, 0.0)
    claim = next(claim for claim in STATEMENTS.judge(evidence) if claim.id == "cpgrl-spread-small")
    assert "exact averages" in claim.claim


def test_satisfied_from_is_the_record_after_the_last_violation():
    exact = np.zeros((3, 4, 2))
    exact[0, 1, 1] = -0.5  # feasible from the record 20 on
    exact[1, 3, 1] = -0.5  # never: counts as 40
    learned = LearningCurves(np.array([0, 10, 20, 30]), exact, exact, np.zeros((3, 4, 1, 1)))
    evidence = Evidence({"cpgrl": learned}, np.zeros(2), np.zeros(1), 0.0)
    assert evidence.satisfied_from("cpgrl") == pytest.approx((20 + 40 + 0) / 3)


def test_moments_beyond_a_short_training_are_its_last_record():
    learned = LearningCurves(np.array([0, 10, 20]), *[np.zeros((1, 3, 2))] * 2, np.zeros((1, 3, 1, 1)))
    assert learned.since(1000) == slice(2, None)
    assert learned.since(11) == slice(2, None)
    assert learned.since(10) == slice(1, None)


def test_violation_is_measured_from_the_thresholds():
    exact = np.array([[[5.0, 0.3, -0.2]]])
    learned = LearningCurves(np.array([0]), exact, exact, np.zeros((1, 1, 1, 1)))
    assert learned.violation(np.array([0.4, -0.3])) == pytest.approx(0.1)
    assert learned.violation(np.array([0.0, -0.5])) == 0


def test_the_spread_divides_by_runs_minus_one():
    assert spread(np.array([[1.0], [3.0]])) == pytest.approx(np.sqrt(2))
    assert spread(np.array([[1.0]])) == 0


def test_claims_are_written_with_their_fields_and_plain_numbers(tmp_path):
    claims = STATEMENTS.judge(Evidence({"cpgrl": CPGRL, "conb": CONB, "sum": SUM}, OPTIMUM, NO_THRESHOLDS, 0.0))
    write_claims(claims, tmp_path / "claims.json")
    written = json.loads((tmp_path / "claims.json").read_text(encoding="utf-8"))
    assert len({claim["id"] for claim in written}) == len(written) == len(claims)
    for claim in written:
        assert [*claim] == ["id", "claim", "source", *["about"] * ("about" in claim), "measured", "holds"]
        assert ("about" in claim) == ("conb" in claim["id"] or claim["id"] in ("sum-best-r1", "all-choose-a1-in-s1"))
        assert isinstance(claim["holds"], bool)
        assert claim["measured"]
        assert all(isinstance(value, float) for value in claim["measured"].values())


def test_the_printed_table_shows_every_claim_and_the_count():
    console = Console(width=200, file=io.StringIO())
    holds = Claim("a", "first", "§1", "", {"of_[x]": 1.0}, True)
    print_claims([holds, Claim("b", "second", "§2", "", {}, False)], console)
    text = console.file.getvalue()
    assert "first" in text
    assert "of [x] 1" in text
    assert "1 of 2 claims hold." in text
