"""``wordcraft-kg suggest``."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from wordcraft_kg.base.settings import whole
from wordcraft_kg.cli.console import Flag, Output, aligned
from wordcraft_kg.cli.options import MovedGraph

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.suggestions import Suggestions

EXAMPLES = (
    "wordcraft-kg suggest models/everyday-recipes --goal bread",
    "wordcraft-kg suggest models/materials --goal BaTi0.9Zr0.1O3 --top 5 --json",
)


def suggest(
    model: Path,
    *,
    goal: str,
    top: int = 5,
    any_parts: Flag = False,
    rule: str | None = None,
    graph: MovedGraph = None,
    output: Output = Output(),
) -> None:
    """Suggest recipes for a goal, best first, with the train recipes that support them.

    A model of sets (train-recipes on a book of larger sets, or with --parts) gives probabilities,
    and suggests recipes for goals that the book lacks, by their parts and words.

    Args:
        model: model folder from train-recipes.
        goal: entity to make.
        top: most recipes to list.
        any_parts: also allow ingredients with parts that the goal lacks, or sets that lack a part
            of the goal.
        rule: function of yours, module:function, that allows sets of a model of sets: it takes a
            tuple of ingredients and the goal, and returns True or False.
    """
    from wordcraft_kg.evaluation.suggestions import open_suggesting, suggest_recipes
    from wordcraft_kg.models.scorers.sets.rules import read_rule

    whole("top", top, 1)
    user_rule = read_rule(rule) if rule else None
    suggesting = open_suggesting(model, graph)
    view = suggest_recipes(suggesting, goal, top, has_coverage=not any_parts, rule=user_rule)
    output.result(view, list(suggestion_lines(view)))


def suggestion_lines(view: "Suggestions") -> Iterator[str]:
    """Yield suggestions, or a scored set, as lines of text."""
    if view.new:
        names = ", ".join(f"'{label}'" for label in view.new)
        yield f"{names} not in the graph: scored by parts and words."
    if not view.suggestions:
        yield "no answer: nothing is left to propose"
        return
    rows = [("probability" if view.suggestions[0].probability is not None else "nats", "", "")]
    for suggestion in view.suggestions:
        value = f"{suggestion.score:.3f}"
        if suggestion.probability is not None:
            value = f"{suggestion.probability:.3f}"
        recipe = f"{' + '.join(suggestion.ingredients)} -> {view.goal}"
        rows.append((f"{value:>11}", suggestion.known, recipe))
    heading, *lines = aligned(rows)
    yield heading.rstrip()
    for line, suggestion in zip(lines, view.suggestions, strict=True):
        yield line
        if suggestion.because:
            supports = (
                f"{' + '.join(near.ingredients)} -> {near.result} ({near.strength:.2g})"
                for near in suggestion.because
            )
            yield f"{'':11}  because {', '.join(supports)}"
    if view.trained_on == "full":
        yield "The model was trained on all recipes, test recipes included."
