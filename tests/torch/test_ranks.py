"""One model in parts on 1, 2 and 4 ranks of gloo: the same training to rounding, and the same bits on all ranks."""

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from .ranks import COUNT


def test_a_training_is_the_same_on_every_number_of_ranks(tmp_path: Path) -> None:
    script = Path(__file__).parent / "ranks.py"
    started = [subprocess.Popen([sys.executable, str(script), str(rank), str(tmp_path)]) for rank in range(COUNT)]
    try:
        assert [each.wait(timeout=400) for each in started] == [0] * COUNT
    finally:
        for each in started:
            each.kill()
    found = [pickle.loads((tmp_path / f"{rank}.pickle").read_bytes()) for rank in range(COUNT)]
    for way in ("backward", "optimizer"):
        whole, told = found[0][way, 1]
        assert any(each[:2].any() for each in told)
        for few in (2, 4):
            parts = [found[rank][way, few] for rank in range(few)]
            np.testing.assert_allclose(np.concatenate([part for part, _ in parts]), whole, atol=1e-11)
            for _, its in parts:
                np.testing.assert_array_equal(its, parts[0][1])
