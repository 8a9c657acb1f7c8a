"""Writing model folders with elicited recipes: scorer, recipe table, unparsed lines and metrics."""

import csv
import hashlib
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from wordcraft_kg.apps.elicitation.answers import Answer
from wordcraft_kg.apps.elicitation.config import ElicitationConfig
from wordcraft_kg.apps.elicitation.prompts import TEMPLATE_HASH, Prompt
from wordcraft_kg.apps.elicitation.reading import WHYS, ElicitedRecipe, Unread, read_elicited
from wordcraft_kg.apps.elicitation.records import Agreement, ElicitationMetrics
from wordcraft_kg.apps.elicitation.scorer import ElicitedScorer
from wordcraft_kg.base.artefacts import dump_json, staged_folder, with_a_name, write_atomically
from wordcraft_kg.base.records import as_values
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.models.scorers.folder import write_scorer
from wordcraft_kg.runs.cards import front_matter
from wordcraft_kg.runs.record import end_run, start_run

TABLE, _UNREAD = "elicited.csv", "unread.txt"
OUTPUTS = ("model.safetensors", "vocabulary.json", "config.toml", "metrics.json", TABLE, _UNREAD)
_MOST_UNREAD = 200  # lines of unread.txt
_LONGEST_LINE = 200


def write_elicited(
    out: str | Path,
    opened: OpenedGraph,
    config: ElicitationConfig,
    prompts: Sequence[Prompt],
    answers: Sequence[Answer],
    *,
    force: bool = False,
) -> tuple[Path, ElicitationMetrics]:
    """Write a model folder with the recipes in the answers; return folder and metrics. Only metrics use the split.

    Raises:
        OutputExistsError: if ``out`` exists and ``force`` is False.
    """
    graph = opened.graph
    elicited, unread = read_elicited(prompts, answers, graph.entities)
    rows = np.array([one.recipe for one in elicited], dtype=np.int64).reshape(-1, 3)
    scorer = ElicitedScorer.of(rows, [one.weight for one in elicited], graph.entities, graph.hash)
    metrics = _metrics(opened, prompts, answers, elicited, unread)
    inputs = {
        "graph": graph.hash,
        "split": opened.split.hash,
        "prompt_template": TEMPLATE_HASH,
        "answers": hashlib.sha256("".join(answer.hash for answer in answers).encode()).hexdigest(),
    }
    folder = with_a_name(Path(out))
    with staged_folder(folder, force=force) as staging:
        config.write(staging)
        write_scorer(staging, scorer.kind, scorer.tensors(), graph)
        write_atomically(staging / "metrics.json", dump_json(as_values(metrics)))
        write_atomically(staging / TABLE, _table(elicited, graph.entities))
        write_atomically(staging / _UNREAD, _examples(unread))
        write_atomically(staging / "README.md", _card(opened, config, metrics))
        end_run(staging, start_run(staging, config.command, seed=config.settings.seed, inputs=inputs), "done", OUTPUTS)
    return folder, metrics


def _metrics(
    opened: OpenedGraph,
    prompts: Sequence[Prompt],
    answers: Sequence[Answer],
    elicited: Sequence[ElicitedRecipe],
    unread: Sequence[Unread],
) -> ElicitationMetrics:
    why = Counter(one.why for one in unread)
    return ElicitationMetrics(
        template=TEMPLATE_HASH,
        prompts=len(prompts),
        goals=sum(len(prompt.goals) for prompt in prompts),
        goals_answered=len({one.recipe[2] for one in elicited}),
        elicited=len(elicited),
        unread={name: why[name] for name in WHYS},
        cut=sum(answer.finish == "length" for answer in answers),
        models=tuple(sorted({answer.model for answer in answers if answer.model})),
        agreement={"all": agreement(opened, elicited), "test": agreement(opened, elicited, test_only=True)},
    )


def agreement(opened: OpenedGraph, elicited: Sequence[ElicitedRecipe], *, test_only: bool = False) -> Agreement:
    """Compare elicited with all graph recipes, or (``test_only``) test recipes, ignoring train and valid recipes."""
    recipes, is_in = opened.graph.recipes, opened.split.is_in("test") | (not test_only)
    wanted, others = ({tuple(row) for row in recipes[rows].tolist()} for rows in (is_in, ~is_in))
    named = [one.recipe for one in sorted(elicited, key=lambda one: -one.rank) if one.recipe not in others]
    first = {recipe[2]: recipe for recipe in named}  # the best rank
    goals = {recipe[2] for recipe in wanted}
    right, hits = len(wanted.intersection(named)), len(wanted.intersection(first.values()))
    return Agreement(
        elicited=len(named),
        recipes=len(wanted),
        right=right,
        precision=right / len(named) if named else None,
        recall=right / len(wanted) if wanted else None,
        goals=len(goals),
        first_right=hits / len(goals) if goals else None,
    )


def _table(elicited: Sequence[ElicitedRecipe], entities: Sequence[str]) -> str:
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["ingredient_a", "ingredient_b", "result", "weight"])
    for one in sorted(elicited, key=lambda one: (one.recipe[2], one.rank)):
        writer.writerow([*(entities[entity] for entity in one.recipe), f"{one.weight:.6g}"])
    return buffer.getvalue()


def _examples(unread: Sequence[Unread]) -> str:
    rows = dict.fromkeys(f"{one.why}\t{' '.join(one.line.split())[:_LONGEST_LINE]}" for one in unread)
    return "".join(f"{row}\n" for row in list(rows)[:_MOST_UNREAD])


def _card(opened: OpenedGraph, config: ElicitationConfig, metrics: ElicitationMetrics) -> str:
    graph, everything, test = opened.graph, metrics.agreement["all"], metrics.agreement["test"]
    a, b, result = graph.recipe_labels()[0] if graph.num_recipes else (*(graph.entities * 3)[:3],)
    unread = ", ".join(f"{number:,} {why}" for why, number in metrics.unread.items() if number) or "none"

    def shown(share: float | None) -> str:
        return "–" if share is None else f"{share:.3f}"

    return f"""{front_matter("knowledge-graph", "language-model")}
# Recipes for {graph.name} elicited from {config.model}

A language model listed pairs that could make each of {graph.num_entities:,} entities. The prompts contained entity
labels, without recipes or split information, so no score was learned from train or test recipes; but a language model
may have seen a published book during training.

- model `{config.model}` at {config.endpoint}{f"; answered as {', '.join(metrics.models)}" if metrics.models else ""}
- {metrics.prompts:,} prompts, template `{metrics.template[:12]}`; {metrics.elicited:,} elicited recipes for \
{metrics.goals_answered:,} of {metrics.goals:,} entities; unparsed lines: {unread}
- graph `{graph.hash[:12]}`; split `{opened.split.config.kind}`, seed {opened.split.config.seed}

| recipes | precision | recall | first pair correct |
|---|---|---|---|
| all | {shown(everything.precision)} | {shown(everything.recall)} | {shown(everything.first_right)} |
| test part | {shown(test.precision)} | {shown(test.recall)} | {shown(test.first_right)} |

`{TABLE}` lists the elicited recipes, `{_UNREAD}` examples of unparsed lines. The first pair has weight 1, the next
3/4, then 2/3, 5/8, ...

```python
from wordcraft_kg import load_scorer

scorer = load_scorer("this folder")
scorer.score_recipes({a!r}, {b!r}, {result!r})  # the weight, 0 if not elicited
```
"""
