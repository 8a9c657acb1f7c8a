"""Read scores of sets for results from a CSV file, such as a language model's opinions."""

import csv
from pathlib import Path

import torch

from wordcraft_kg.base import KnowledgeFileError, UnknownEntityError, read_large_file
from wordcraft_kg.graphs import MOST_INGREDIENTS, RecipeGraph, padded
from wordcraft_kg.models.scorers.factors import SetTableScorer

_COLUMNS = ["result", "score", "set"]
_LARGEST = 1e30
"""Largest score: the sum of the squares of all has to be a finite number."""


def read_scores(path: Path, graph: RecipeGraph) -> SetTableScorer:
    """Read a table of scores as a scorer; scores are standardised, and 0 where there is none.

    Args:
        path: CSV in UTF-8 with a header: ``set``, ingredients as ``a + b``; ``result``; and
            ``score``, higher is more plausible.
        graph: the recipe graph, whose labels the file has.

    Raises:
        KnowledgeFileError: for another header, an unknown label, a score that is no finite number
            or too large, or a set and result that stand twice; the message names the line.
        ArtefactError: if there is no such file, or it is too large.
    """
    try:
        text = read_large_file(path).decode("utf-8-sig")
        table = csv.DictReader(text.splitlines())
        names = table.fieldnames or ()
    # csv.Error: such as a cell of a megabyte.
    except (UnicodeDecodeError, csv.Error) as error:
        raise KnowledgeFileError(f"{path}: {error}. Save it as CSV in UTF-8.") from None
    # Also a column that stands twice is refused.
    if sorted(names) != _COLUMNS:
        raise KnowledgeFileError(
            f"{path}: found the columns {', '.join(map(repr, names)) or 'none'}; expected set, "
            "result and score."
        )
    values: dict[tuple[tuple[int, ...], int], float] = {}
    try:
        for row in table:
            ingredients, result, score = _cells(row, graph)
            if (ingredients, result) in values:
                raise ValueError("this set and result stand in an earlier line, too.")
            values[ingredients, result] = score
    except (UnknownEntityError, ValueError, csv.Error) as error:
        raise KnowledgeFileError(f"{path}, line {table.reader.line_num}: {error}") from None
    if not values:
        raise KnowledgeFileError(f"{path}: no scores below the header; expected one or more.")
    scores = torch.tensor(list(values.values()), dtype=torch.float64)
    deviation = scores.std(correction=0)
    standardised = (scores - scores.mean()) / (deviation if deviation > 0 else 1)
    sets = [ingredients for ingredients, _ in values]
    tensors = {
        "sets": torch.from_numpy(padded(sets, graph.num_entities, MOST_INGREDIENTS)),
        "results": torch.tensor([result for _, result in values]),
        "values": standardised.float(),
    }
    return SetTableScorer(tensors, graph.entities, graph.hash)


def _cells(row: dict[str, str], graph: RecipeGraph) -> tuple[tuple[int, ...], int, float]:
    """Return the ids of a row's ingredients, ascending, the id of its result, and its score."""
    try:
        labels = row["set"].split(" + ")
        result = row["result"]
        score = float(row["score"])
        # A row with more cells than the header has them below None; one with fewer has None.
        if len(labels) > MOST_INGREDIENTS or None in row or not abs(score) <= _LARGEST:
            raise ValueError
    except (AttributeError, TypeError, ValueError):
        raise ValueError(
            f"found {list(row.values())}; expected 1 to {MOST_INGREDIENTS} ingredients, a result, "
            f"and a finite number up to {_LARGEST:g} as score."
        ) from None
    ids = sorted(graph.id_of(label.strip()) for label in labels)
    return tuple(ids), graph.id_of(result.strip()), score
