"""The model card of a recipe scorer."""

from wordcraft_kg.graphs.doses import dose_words
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.models.recipes.config import RecipesConfig
from wordcraft_kg.models.recipes.records import RecipeMetrics
from wordcraft_kg.runs.cards import front_matter


def model_card(opened: OpenedGraph, config: RecipesConfig, metrics: RecipeMetrics) -> str:
    """Return the ``README.md`` of a model folder."""
    seen = (
        "It was fitted on all recipes, including the test recipes: its scores show what it remembers."
        if metrics.kg == "full"
        else f"It was fitted on {dose_words(metrics.share, metrics.noise) or 'the train recipes'} only."
    )
    folds = (
        f"\n- {metrics.folds} folds: MRR {metrics.fold_mrr:.3f} of train triples by models that have not seen them, "
        f"{metrics.fold_in_sample_mrr:.3f} by the one that has"
        if metrics.fold_mrr is not None
        else ""
    )
    a, b, result = opened.graph.recipe_labels()[0]
    return f"""{front_matter("knowledge-graph", "link-prediction")}
# A recipe scorer of the {metrics.kg} knowledge graph of {opened.graph.name}

Scores recipes, `score_recipes(a, b, result)`, and triples with the relations `combinesWith` and `componentOf`. {seen}

- graph `{opened.graph.hash[:12]}`: {opened.graph.num_entities:,} entities; split `{opened.split.config.kind}`, seed \
{opened.split.config.seed}; {metrics.recipes:,} recipes; words: {config.settings.features}{folds}

`config.toml` reproduces it; `run.json` names the versions that made it. Its quality on unseen triples is what
`wordcraft-kg evaluate-links` reports.

```python
from wordcraft_kg import load_scorer

scorer = load_scorer("this folder")
scorer.score_recipes({a!r}, {b!r}, {result!r})  # nats: higher is more plausible
scorer.speaking_for({a!r}, {b!r}, {result!r})  # the recipes that say so
```
"""
