"""docs/jax.md runs as printed; the example ends feasible."""

import re
from pathlib import Path

import numpy as np
import pytest

jax = pytest.importorskip("jax")

from cpgrl_opt import Status  # noqa: E402

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/jax.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE, re.S)


def run(example: str) -> dict[str, object]:
    names: dict[str, object] = {}
    exec(compile(example, "docs/jax.md", "exec"), names)
    return names


def test_the_direction_of_the_page_runs_as_printed(capsys: pytest.CaptureFixture[str]) -> None:
    info = run(EXAMPLES[0])["info"]
    assert (np.asarray(info.status) == Status.OPTIMAL).all()
    assert np.asarray(info.slack)[-1].min() >= -1e-6
    assert capsys.readouterr().out.startswith("0 [")


def test_the_optimiser_of_the_page_runs_as_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert len(EXAMPLES) == 2
    state = run(EXAMPLES[1])["state"]
    assert state.info.status == Status.OPTIMAL
    assert capsys.readouterr().out.startswith("0 [")


@pytest.mark.parametrize("way", ["direction", "adam"])
def test_reinforce_ends_feasible(way: str, capsys: pytest.CaptureFixture[str]) -> None:
    """It begins with the car hot in two thirds of its time; slow throughout it would earn 1."""
    names = run((ROOT / "examples/jax_reinforce.py").read_text(encoding="utf-8"))
    for seed in range(5):
        reward, hot, first = names["train"](way, seed=seed)
        assert first > 0.5
        assert hot <= names["LIMIT"]
        assert reward >= 1.35
    assert capsys.readouterr().out.count("at the end: reward") == 5
