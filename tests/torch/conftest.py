"""A small network with losses, and costs of which each demand can be read off."""

from typing import Any

import pytest


@pytest.fixture
def net() -> Any:
    """Two layers, one with a frozen bias; 4 → 3."""
    torch = pytest.importorskip("torch")  # here: a skip of this file would end the whole collection
    torch.manual_seed(0)
    found = torch.nn.Sequential(torch.nn.Linear(4, 6), torch.nn.Tanh(), torch.nn.Linear(6, 3)).double()
    found[0].bias.requires_grad_(False)
    return found


@pytest.fixture
def batch() -> Any:
    torch = pytest.importorskip("torch")
    torch.manual_seed(1)
    return torch.randn(16, 4, dtype=torch.float64)
