"""Sums of products over rows of a matrix: in four lanes for speed, in twice the precision for refinement."""

from ...compensated import product_error, split, two_sum
from ._entry_point import inlined, kernel

for each in (split, product_error, two_sum):
    inlined(each)


@inlined
def inner(A, a, B, b):
    """Row a of A · row b of B, in four lanes; the same order every time, so bit for bit reproducible."""
    n = A.shape[1]
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    cut = n - n % 4
    for j in range(0, cut, 4):
        s0 += A[a, j] * B[b, j]
        s1 += A[a, j + 1] * B[b, j + 1]
        s2 += A[a, j + 2] * B[b, j + 2]
        s3 += A[a, j + 3] * B[b, j + 3]
    for j in range(cut, n):
        s0 += A[a, j] * B[b, j]
    return (s0 + s1) + (s2 + s3)


@kernel
def dot(matrix, a, b):
    """Row a · row b."""
    return inner(matrix, a, matrix, b)


@kernel
def add(matrix, a, c, b):
    """Row a += c · row b."""
    for j in range(matrix.shape[1]):
        matrix[a, j] += c * matrix[b, j]


@kernel
def add_product(high, low, a, b):
    """high + low + a·b as an unevaluated sum. Source: Dekker 1971; Ogita, Rump & Oishi 2005, Dot2."""
    a_high, a_low = split(a)
    b_high, b_low = split(b)
    product = a * b
    error = product_error(product, a_high, a_low, b_high, b_low)
    total, lost = two_sum(high, product)
    return total, low + (error + lost)
