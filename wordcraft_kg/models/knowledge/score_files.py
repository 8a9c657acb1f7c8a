"""Read scores of sets for results from a CSV file, such as a language model's opinions."""

import csv
from pathlib import Path

import torch

from wordcraft_kg.base import KnowledgeFileError, UnknownEntityError, read_large_file
from wordcraft_kg.graphs import RecipeGraph, padded
from wordcraft_kg.models.scorers.factors import SetTableScorer

_PLACES = 8
"""Most ingredients of a set."""
_LARGEST = 1e30
"""Largest score: the sum of the squares of all has to be a finite number."""


def read_scores(path: Path, graph: RecipeGraph) -> SetTableScorer:
    """Read a table of scores as a scorer; scores are standardised, and 0 where there is none.

    Args:
        path: CSV in UTF-8 with a header: ``set`` (ingredients as ``a + b``), or any other names for
            a column of each ingredient; ``result``; and ``score``, higher is more plausible.
        graph: the recipe graph, whose labels the file has.

    Raises:
        KnowledgeFileError: for another header, an unknown label, a score that is no finite number
            or too large, or a set and result that stand twice; the message names the line.
        ArtefactError: if there is no such file, or it is too large.
    """
    names, rows = _rows(path)
    ingredients = [name for name in names if name not in ("result", "score")]
    if len(ingredients) != len(names) - 2 or not ingredients or len(set(names)) < len(names):
        raise KnowledgeFileError(
            f"{path}: found the columns {', '.join(map(repr, names)) or 'none'}; expected set (or "
            "a column for each ingredient), result and score."
        )
    values: dict[tuple[tuple[int, ...], int], float] = {}
    for line, row in rows:
        place = f"{path}, line {line}"
        try:
            if ingredients == ["set"]:
                labels = row["set"].split(" + ")
            else:
                labels = [row[name] for name in ingredients if row[name]]
            ids = tuple(sorted(graph.id_of(label.strip()) for label in labels))
            key = (ids, graph.id_of(row["result"].strip()))
            score = float(row["score"])
            # A row with more cells than the header has them below None.
            if not 1 <= len(ids) <= _PLACES or None in row or not abs(score) <= _LARGEST:
                raise ValueError
        except UnknownEntityError as error:
            raise KnowledgeFileError(f"{place}: {error}") from None
        except (AttributeError, TypeError, ValueError):
            raise KnowledgeFileError(
                f"{place}: found {list(row.values())}; expected 1 to {_PLACES} ingredients, a "
                f"result, and a finite number up to {_LARGEST:g} as score."
            ) from None
        if key in values:
            raise KnowledgeFileError(f"{place}: this set and result stand in an earlier line, too.")
        values[key] = score
    if not values:
        raise KnowledgeFileError(f"{path}: no scores below the header; expected one or more.")
    scores = torch.tensor(list(values.values()), dtype=torch.float64)
    deviation = scores.std(correction=0)
    standardised = (scores - scores.mean()) / (deviation if deviation > 0 else 1)
    tensors = {
        "sets": torch.from_numpy(padded([ids for ids, _ in values], graph.num_entities, _PLACES)),
        "results": torch.tensor([result for _, result in values]),
        "values": standardised.float(),
    }
    return SetTableScorer(tensors, graph.entities, graph.hash)


def _rows(path: Path) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    """Return the names of the columns, and the rows, each with the number of its line."""
    try:
        text = read_large_file(path).decode("utf-8-sig")
        table = csv.DictReader(text.splitlines())
        rows = [(table.line_num, row) for row in table]
    except UnicodeDecodeError as error:
        raise KnowledgeFileError(f"{path}: not UTF-8 ({error.reason}). Save it as UTF-8.") from None
    except csv.Error as error:
        # Such as a cell of a megabyte.
        line = table.line_num + 1
        raise KnowledgeFileError(f"{path}, line {line}: {error}; expected CSV.") from None
    return list(table.fieldnames or ()), rows
