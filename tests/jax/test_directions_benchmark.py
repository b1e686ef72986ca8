"""`benchmarks/jax_directions.py` measures what it says, at a small size."""

from typing import Any

import pytest

pytest.importorskip("jax")


def test_a_direction_is_timed_beside_the_others(load_benchmark: Any) -> None:
    benchmark = load_benchmark("jax_directions")
    row = benchmark.measure(2, 5, 1, "float64", repeats=1)
    assert row.failed == 0
    assert row.error <= 1e-9
    assert min(row.direction, row.gramian, row.textbook, row.numpy) > 0.0
