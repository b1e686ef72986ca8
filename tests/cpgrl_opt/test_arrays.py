"""Shape types are jaxtyping's where shapes are checked, and cost nothing elsewhere."""

from contextlib import suppress

import jaxtyping
import numpy as np
import pytest

from cpgrl_opt import DirectionProblem, arrays
from cpgrl_opt.certify import violation


def test_the_tests_see_the_real_types():
    assert arrays.Float is jaxtyping.Float
    assert arrays.UInt8 is jaxtyping.UInt8


def test_a_wrong_shape_is_noticed_in_the_tests():
    problem = DirectionProblem([1.0, 2.0], [[1.0, 0.0]])
    with pytest.raises(jaxtyping.TypeCheckError):
        violation(problem, np.zeros((1, 2)))


def test_a_wrong_shape_is_noticed_late_in_a_test_too():
    problem = DirectionProblem([1.0, 2.0], [[1.0, 0.0]])
    for _ in range(1000):
        violation(problem, np.zeros(2))
    noticed = 0
    for _ in range(64):
        with suppress(jaxtyping.TypeCheckError):
            violation(problem, np.zeros((2, 1)))
            continue
        noticed += 1
    assert noticed >= 4
