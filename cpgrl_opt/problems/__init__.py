"""Families of direction problems: one source for users, the conformance kit, the comparison and the tests.

    >>> import numpy as np
    >>> from cpgrl_opt.problems import draw_problem
    >>> problem = draw_problem("sum to zero", np.random.default_rng(0))
    >>> bool(problem.jacobian.sum(axis=0).any())
    False

A file for each theme holds the functions that make problems, each written once against a small source of choices
(`source`); `registry` gives them their names and says what is known of the answer.
"""

from .case import Case
from .registry import FAMILIES, Family, draw_problem, families
from .source import RandomSource, Source

__all__ = ["FAMILIES", "Case", "Family", "RandomSource", "Source", "draw_problem", "families"]
