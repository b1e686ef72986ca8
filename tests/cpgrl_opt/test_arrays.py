"""Shapes are checked in the tests."""

from contextlib import suppress

import jaxtyping
import numpy as np

from cpgrl_opt import DirectionProblem
from cpgrl_opt.certify import violation


def test_a_wrong_shape_is_noticed_in_the_tests_late_too():
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
