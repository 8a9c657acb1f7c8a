"""Writing the folds of a cross-fitted scorer: their tensors, and what each says of recipes that it has not seen."""

from collections.abc import Callable, Mapping
from pathlib import Path

import safetensors.torch
import torch

from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.base.records import as_values
from wordcraft_kg.graphs.folds import Folds
from wordcraft_kg.graphs.triples import is_in, recipe_triples
from wordcraft_kg.models.scorers.calibration import fit_probabilities, predictions
from wordcraft_kg.models.scorers.cross_fitting import Fold, FoldsRecord
from wordcraft_kg.models.scorers.folder import (
    CALIBRATION,
    FOLDS_RECORD,
    FOLDS_TENSORS,
    OF_RECIPE,
    TAUGHT,
    kind_of,
    make_scorer,
)
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples, sampled_for
from wordcraft_kg.models.scorers.scorer import Scorer


def write_folds(
    folder: Path, folds: Folds, whole: Scorer, part: Callable[[int], tuple[str, Mapping[str, torch.Tensor]]]
) -> FoldsRecord:
    """Write the files of the folds; return what is known of them.

    Args:
        folder: folder of the model.
        folds: the folds.
        whole: the scorer of all train recipes.
        part: returns the hash of the training triples and the tensors of the model without a fold.
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
        others = make_scorer(kind_of(own_tensors), dict(own_tensors), graph.entities, graph.hash)
        seen_by.append(predictions(others, folds, number))
        mrr, in_sample = (
            mean_reciprocal_rank(rank_triples(scorer, queries, folds.triples())) if len(queries) else None
            for scorer in (others, whole)
        )
        found.append(
            Fold(
                trained_on=trained_on,
                triples=len(seen),
                queries=2 * len(queries),
                mrr=mrr,
                in_sample_mrr=in_sample,
            )
        )
    record = FoldsRecord(seed=folds.seed, hash=folds.hash, folds=tuple(found))
    write_atomically(folder / CALIBRATION, dump_json(as_values(fit_probabilities(whole, folds, seen_by))))
    write_atomically(folder / FOLDS_TENSORS, safetensors.torch.save(tensors))
    write_atomically(folder / FOLDS_RECORD, dump_json(as_values(record)))
    return record
