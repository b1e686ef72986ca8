"""Stochastic policies: immutable, with their parameters, samples and scores."""

from .interface import Policy
from .linear_gaussian import LinearGaussian
from .linear_softmax import LinearSoftmax
from .normalized_gaussian_network import NormalizedGaussianNetwork
from .softmax_table import SoftmaxTable, softmax

__all__ = ["LinearGaussian", "LinearSoftmax", "NormalizedGaussianNetwork", "Policy", "SoftmaxTable", "softmax"]
