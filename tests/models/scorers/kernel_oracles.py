"""Slow references for the recipe kernel: loops that follow the formulas word by word."""

import math
from collections.abc import Sequence
from itertools import product

import numpy as np

Recipes = Sequence[Sequence[int]]


def slow_profiles(recipes, size):
    """The row of each entity in ``[C | P | Pᵀ | 2 R]``, damped by column sums to the power 1/4, of
    length 1."""
    rows = [{} for _ in range(size)]
    for a, b, c in recipes:
        for one, other in ((a, b), (b, a)):
            rows[one]["C", other] = 1.0
            rows[one]["P", c] = 1.0
            rows[c]["PT", one] = 1.0
            rows[one]["R", other, c] = 2.0
    totals = {}
    for row in rows:
        for column, value in row.items():
            totals[column] = totals.get(column, 0.0) + value
    for row in rows:
        for column in row:
            row[column] /= totals[column] ** 0.25
        length = math.sqrt(sum(value**2 for value in row.values()))
        for column in row:
            row[column] /= length
    return rows


def slow_similarity(recipes, vectors):
    rows = slow_profiles(recipes, len(vectors))
    kernel = np.zeros((len(vectors), len(vectors)))
    for x, row in enumerate(rows):
        for y, other in enumerate(rows):
            kernel[x, y] = sum(value * other.get(column, 0.0) for column, value in row.items())
            lengths = np.linalg.norm(vectors[x]) * np.linalg.norm(vectors[y])
            if lengths:
                kernel[x, y] += 0.2 * max(0.0, float(vectors[x] @ vectors[y]) / lengths) ** 2
    return kernel


def explicit_ridge(kernel, links, ridge):
    """Ridge regression on all E² pairs with the E² x E² matrix of the product kernel."""
    size = len(kernel)
    gram = np.zeros((size**2, size**2))
    for x, y, z, t in product(range(size), repeat=4):
        gram[x * size + y, z * size + t] = kernel[x, z] * kernel[y, t]
    return (gram @ np.linalg.solve(gram + ridge * np.eye(size**2), links.reshape(-1))).reshape(
        size, size
    )


def slow_completion(recipes, size):
    """Sum over results and over paths a - y - x - b of pairs that make the result, each pair by its
    degrees."""
    table = np.zeros((size, size))
    for result in {c for _, _, c in recipes}:
        makes = {pair for a, b, c in recipes if c == result for pair in ((a, b), (b, a))}
        degree = {x: sum(pair[0] == x for pair in makes) for x, _ in makes}
        for (a, y), (second, x), (third, b) in product(makes, repeat=3):
            if second == y and third == x:
                table[a, b] += 1 / math.prod(
                    math.sqrt(degree[i] * degree[j]) for i, j in ((a, y), (y, x), (x, b))
                )
    return table
