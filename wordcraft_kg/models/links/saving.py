"""Writing any scorer as a model folder, so that it goes wherever one that was trained here does."""

from pathlib import Path

import safetensors.torch
import torch
from torch import Tensor

from wordcraft_kg.base.artefacts import dump_json, staged_folder, with_a_name, write_atomically
from wordcraft_kg.base.errors import ConfigError, GraphMismatchError
from wordcraft_kg.base.records import as_values
from wordcraft_kg.base.tensors import copied
from wordcraft_kg.graphs.folder import OpenedGraph, Taught
from wordcraft_kg.graphs.folds import Folds
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.links.config import SavedConfig
from wordcraft_kg.models.scorers.config import TABLE_LIMIT, table_bytes
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted
from wordcraft_kg.models.scorers.factors import ComplExScorer, factor_names
from wordcraft_kg.models.scorers.fold_files import write_folds
from wordcraft_kg.models.scorers.folder import FOLD_OUTPUTS, ScorerKind, Vocabulary
from wordcraft_kg.models.scorers.opinions import OpinionScorer
from wordcraft_kg.models.scorers.protocol import FactoredScorer, TripleScorer, check_scorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.runs.cards import front_matter
from wordcraft_kg.runs.config_file import CONFIG_FILE
from wordcraft_kg.runs.record import end_run, start_run

OUTPUTS = ("model.safetensors", "vocabulary.json", CONFIG_FILE)


def save_scorer(
    folder: str | Path,
    scorer: TripleScorer,
    opened: OpenedGraph,
    *,
    kg: Taught,
    origin: str = "",
    force: bool = False,
) -> Path:
    """Write a scorer of your own as a model folder, which every command then takes like one that was trained here.

    With folds, see :func:`~wordcraft_kg.models.scorers.cross_fitting.cross_fit`, agents learn on honest scores.

    The folder holds the scores of all triples, or the embeddings of a
    :class:`~wordcraft_kg.models.scorers.factors.ComplExScorer`, or, where a table of the scores would be too large,
    the factors of a :class:`~wordcraft_kg.models.scorers.protocol.FactoredScorer`. It says that it was not trained
    here.

    Args:
        folder: folder to write.
        scorer: scores triples of the graph.
        opened: the graph, and the split that the scorer is judged by.
        kg: what the scorer has seen: ``partial`` if nothing but the train recipes; ``full`` if any other recipe of the
            graph, so that its figures are marked as memory; ``none`` if no recipe at all, such as one that rests on
            words. Nobody else can know it.
        origin: what the scorer is, in a line for reports. Default: its name.
        force: replace the folder if it exists.

    Raises:
        OutputExistsError: if ``folder`` exists and ``force`` is False.
        GraphMismatchError: if the scorer belongs to another graph.
        ConfigError: if a score is not a finite number, or the graph is too large for a table of all scores.

    Example:
        >>> from wordcraft_kg.models.scorers.baselines import FrequencyScorer
        >>> opened = open_graph("kitchen")
        >>> mine = FrequencyScorer(opened.graph, opened.split.partial)
        >>> folder = save_scorer("models/frequency", mine, opened, kg="partial", origin="counts of the train recipes")
        >>> open_model(folder).kg
        'partial'
    """
    config = SavedConfig(opened.source, kg, origin or getattr(scorer, "name", type(scorer).__name__))
    check_scorer(scorer, opened.graph)
    if tuple(scorer.entities) != opened.graph.entities:
        raise GraphMismatchError(
            f"the scorer's `entities` are not those of '{opened.graph.name}', although it names its hash. Give it the "
            "labels of the graph, in the order of its ids."
        )
    kind, tensors = _tensors_of(scorer)
    vocabulary = Vocabulary(
        format="wordcraft-kg vocabulary 1",
        scorer=kind,
        graph=opened.graph.hash,
        entities=opened.graph.entities,
        relations=RELATIONS,
    )
    out = with_a_name(Path(folder))
    with staged_folder(out, force=force) as staging:
        config.write(staging)
        write_atomically(staging / "model.safetensors", safetensors.torch.save(copied(tensors)))
        write_atomically(staging / "vocabulary.json", dump_json(as_values(vocabulary)))
        write_atomically(staging / "README.md", _model_card(config, opened))
        inputs = {"graph": opened.graph.hash, "split": opened.split.hash}
        outputs: tuple[str, ...] = OUTPUTS
        if isinstance(scorer, CrossFitted):
            inputs["folds"], outputs = scorer.record.hash, (*OUTPUTS, *FOLD_OUTPUTS)
            _write_folds(staging, scorer, opened)
            if scorer.taught is not None:
                inputs["dose"] = scorer.dose(opened.graph).hash
        end_run(staging, start_run(staging, config.command, inputs=inputs), "done", outputs)
    return out


def _write_folds(folder: Path, scorer: CrossFitted, opened: OpenedGraph) -> None:
    scorer.check_split(opened.split)

    def part(fold: int) -> tuple[str, dict[str, Tensor]]:
        scorer.trained_on(fold, opened.graph)  # or it is refused
        return scorer.record.folds[fold].trained_on, _tensors_of(scorer.left_out(fold))[1]

    dose = scorer.dose(opened.graph)
    folds = Folds(opened.split, scorer.count, scorer.record.seed, scorer.of_recipe, dose)
    write_folds(folder, folds, scorer.whole, part)


def _tensors_of(scorer: TripleScorer) -> tuple[ScorerKind, dict[str, Tensor]]:
    kind: ScorerKind = "table"
    if isinstance(scorer, CrossFitted):
        scorer = scorer.whole
    if isinstance(scorer, RecipeScorer):
        return "recipes", scorer.tensors()
    if isinstance(scorer, OpinionScorer):
        return "opinions", scorer.tensors()
    if isinstance(scorer, ComplExScorer):
        kind, tensors = "complex", scorer.embeddings()
    elif isinstance(scorer, FactoredScorer) and table_bytes(len(scorer.entities)) > TABLE_LIMIT:
        kind, tensors = "factors", {}
        for names, relation in zip(factor_names(), RELATIONS, strict=True):
            parts = scorer.factors(RELATIONS.index(relation))
            tensors |= zip(names, (part.to("cpu", torch.float32) for part in parts), strict=True)
    else:
        size = len(scorer.entities)
        if table_bytes(size) > TABLE_LIMIT:
            raise ConfigError(
                f"the scores of all triples of {size:,} entities take {len(RELATIONS) * size**2 * 4 / 2**20:,.0f} MiB; "
                f"expected at most {TABLE_LIMIT / 2**20:.0f} MiB. Only a ComplExScorer, or a scorer with "
                "`factors`, can be saved without them."
            )
        tables = [scorer.table(relation).to("cpu", torch.float32) for relation in range(len(RELATIONS))]
        for relation, table in zip(RELATIONS, tables, strict=True):
            if table.shape != (size, size):
                raise ConfigError(
                    f"the scorer's table of {relation} has shape {tuple(table.shape)}; expected {(size, size)}, by "
                    "head and tail."
                )
        tensors = {"scores": torch.stack(tables)}
    if not all(torch.isfinite(tensor).all() for tensor in tensors.values()):
        raise ConfigError("the scorer gives scores that are not finite numbers. Nothing was written.")
    return kind, tensors


def _model_card(config: SavedConfig, opened: OpenedGraph) -> str:
    seen = {
        "full": "It is recorded as having seen more than the train recipes: its scores show what it remembers.",
        "partial": "It is recorded as having seen the train recipes only.",
        "none": "It is recorded as having seen no recipe of the graph.",
    }[config.kg]
    return f"""{front_matter("knowledge-graph", "link-prediction")}
# A scorer for {opened.graph.name}

{config.origin}

It was not trained by wordcraft-kg but saved with it, so nothing here can reproduce it. {seen}

- graph `{opened.graph.hash[:12]}`: {opened.graph.num_entities:,} entities; split `{opened.split.config.kind}`, seed \
{opened.split.config.seed}

Its quality on unseen triples is what `wordcraft-kg evaluate-links` reports. Scores are not calibrated probabilities.

```python
from wordcraft_kg import load_scorer

scorer = load_scorer("this folder")
scorer.top(None, "componentOf", {opened.graph.entities[0]!r})
```
"""
