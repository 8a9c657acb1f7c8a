"""Slow references for the recipe kernel: loops that follow the formulas word by word."""

import math
from itertools import product

import numpy as np


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


def explicit_ridge(kernel, links, seen):
    """Ridge regression (λ = 1) on the pairs of ``seen``, by the matrix of the product kernel.

    Directions in which the kernel is negative are left out.
    """
    values, vectors = np.linalg.eigh(kernel[np.ix_(seen, seen)])
    coordinates = kernel[:, seen] @ vectors[:, values > 1e-9] / np.sqrt(values[values > 1e-9])
    known = coordinates[seen]
    # Rows are pairs (x, y), columns products of directions.
    parts = np.kron(known, known)
    weights = np.linalg.solve(
        parts.T @ parts + np.eye(parts.shape[1]), parts.T @ links[np.ix_(seen, seen)].ravel()
    )
    size = coordinates.shape[1]
    return coordinates @ weights.reshape(size, size) @ coordinates.T


def link_tables(triples, size):
    """0/1 tables of the links of both relations, row = head."""
    tables = np.zeros((2, size, size))
    for head, relation, tail in triples.tolist():
        tables[relation, head, tail] = 1
    return tables


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
