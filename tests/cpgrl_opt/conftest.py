"""Shared by the tests of cpgrl_opt."""

import pytest

from .long import least_products


@pytest.fixture
def every_problem_is_long():
    """Problems with n > 4 (1 + m) go through the ladder, whatever their size."""
    with least_products(0):
        yield
