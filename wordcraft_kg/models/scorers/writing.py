"""Writing a scorer and its folds into a model folder."""

from collections.abc import Callable, Mapping
from pathlib import Path

import safetensors.torch
import torch

from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import as_values
from wordcraft_kg.base.tensors import copied
from wordcraft_kg.graphs.folds import Folds
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import RELATIONS, is_in, recipe_triples
from wordcraft_kg.models.scorers.calibration import Probabilities, predictions
from wordcraft_kg.models.scorers.config import TABLE_LIMIT, table_bytes
from wordcraft_kg.models.scorers.cross_fitting import Fold, FoldsRecord, whole_of
from wordcraft_kg.models.scorers.factors import FactorsScorer
from wordcraft_kg.models.scorers.folder import (
    CALIBRATION,
    FOLDS_RECORD,
    FOLDS_TENSORS,
    OF_RECIPE,
    TAUGHT,
    VOCABULARY,
    WEIGHTS,
    Vocabulary,
    make_scorer,
)
from wordcraft_kg.models.scorers.protocol import FactoredScorer, TripleScorer
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples, sampled_for
from wordcraft_kg.models.scorers.scorer import Scorer, StoredScorer
from wordcraft_kg.models.scorers.tables import TableScorer

Tensors = Mapping[str, torch.Tensor]


def stored(scorer: TripleScorer) -> StoredScorer:
    """Return the stored form of a scorer (of ``whole`` if cross-fitted).

    Scorers without a stored form become a table, or factors above the table limit.

    Raises:
        ConfigError: if neither is possible, or a score is not finite.
    """
    scorer, size = whole_of(scorer), len(scorer.entities)
    found: StoredScorer
    if isinstance(scorer, StoredScorer) and not isinstance(scorer, TableScorer | FactorsScorer):
        found = scorer
    elif table_bytes(size) <= TABLE_LIMIT:
        tables = [scorer.table(relation).to("cpu", torch.float32) for relation in range(len(RELATIONS))]
        for relation, table in zip(RELATIONS, tables, strict=True):
            if table.shape != (size, size):
                raise ConfigError(
                    f"the scorer's table of {relation} has shape {tuple(table.shape)}; expected {(size, size)}, by "
                    "head and tail."
                )
        found = TableScorer(torch.stack(tables), scorer.entities, scorer.graph_hash)
    elif isinstance(scorer, FactoredScorer):
        factors = [scorer.factors(relation) for relation in range(len(RELATIONS))]
        found = FactorsScorer(factors, scorer.entities, scorer.graph_hash)
    else:
        raise ConfigError(
            f"the scores of all triples of {size:,} entities take {len(RELATIONS) * size**2 * 4 / 2**20:,.0f} MiB; "
            f"expected at most {TABLE_LIMIT / 2**20:.0f} MiB. Only a ComplExScorer, or a scorer with "
            "`factors`, can be saved without them."
        )
    if not all(torch.isfinite(tensor).all() for tensor in found.tensors().values()):
        raise ConfigError("the scorer gives scores that are not finite numbers. Nothing was written.")
    return found


def write_scorer(folder: Path, kind: str, tensors: Tensors, graph: RecipeGraph) -> None:
    """Write the tensors of a scorer and their vocabulary."""
    vocabulary = Vocabulary(scorer=kind, graph=graph.hash, entities=graph.entities, relations=RELATIONS)
    write_atomically(folder / WEIGHTS, safetensors.torch.save(copied(dict(tensors))))
    write_atomically(folder / VOCABULARY, dump_json(as_values(vocabulary)))


def write_folds(
    folder: Path, folds: Folds, whole: Scorer, kind: str, part: Callable[[int], tuple[str, Tensors]]
) -> FoldsRecord:
    """Write the files of the folds and return their record.

    Args:
        folder: folder of the model.
        folds: the folds.
        whole: the scorer of all train recipes.
        kind: kind of the fold scorers.
        part: returns the hash of the training triples, and the tensors, of the model without a fold.
    """
    graph = folds.split.graph
    tensors = {OF_RECIPE: torch.from_numpy(folds.of_recipe.copy())}
    if folds.is_dosed:
        tensors[TAUGHT] = torch.from_numpy(folds.dose.results.copy())
    found, seen_by = [], []
    for number in range(folds.count):
        trained_on, own_tensors = part(number)
        tensors |= {f"fold{number}.{name}": tensor for name, tensor in own_tensors.items()}
        seen = folds.triples([number])
        own = recipe_triples(folds.recipes_of(number))
        queries = sampled_for(graph, own[~is_in(own, seen, graph.num_entities)])
        others = make_scorer(kind, own_tensors, graph.entities, graph.hash)
        seen_by.append(predictions(others, folds, number))
        mrr, in_sample = (
            mean_reciprocal_rank(rank_triples(scorer, queries, folds.triples())) if len(queries) else None
            for scorer in (others, whole)
        )
        found.append(
            Fold(trained_on=trained_on, triples=len(seen), queries=2 * len(queries), mrr=mrr, in_sample_mrr=in_sample)
        )
    record = FoldsRecord(seed=folds.seed, hash=folds.hash, folds=tuple(found))
    write_atomically(folder / CALIBRATION, dump_json(as_values(Probabilities.fit(whole, folds, seen_by))))
    write_atomically(folder / FOLDS_TENSORS, safetensors.torch.save(tensors))
    write_atomically(folder / FOLDS_RECORD, dump_json(as_values(record)))
    return record
