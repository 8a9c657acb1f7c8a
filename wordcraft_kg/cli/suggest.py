"""``wordcraft-kg suggest``."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.base import ConfigError, counted, whole
from wordcraft_kg.cli.console import Flag, Output, aligned, command_line, split_labels
from wordcraft_kg.cli.options import MovedGraph, Words

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.suggestions import SetSupport, Suggestion, Suggestions, Wish
    from wordcraft_kg.graphs import RecipeGraph

EXAMPLES = (
    "wordcraft-kg suggest models/everyday-recipes",
    "wordcraft-kg suggest models/everyday-recipes ham + cheese",
    "wordcraft-kg suggest models/everyday-recipes --with-item banana --out suggestions.csv",
    "wordcraft-kg suggest models/everyday-recipes --accept suggestions.csv --out longer.csv",
    "wordcraft-kg suggest models/materials --goal BaTi0.9Zr0.1O3 --top 5 --json",
)


def suggest(  # noqa: PLR0913 - parameters are the command's options
    model: Path,
    *pair: str,
    goal: str | None = None,
    with_item: str | None = None,
    start: Annotated[Words, Parameter(name="--from")] = None,
    top: int = 20,
    any_parts: Flag = False,
    rule: str | None = None,
    out: Path | None = None,
    accept: Path | None = None,
    graph: MovedGraph = None,
    output: Output = Output(),
) -> None:
    """Suggest recipes that the book lacks, the most probable first, with the recipes behind them.

    Without further words, suggestions are for the whole book. On a page of 20 no item is in more
    than three, but those that you name. Where no known entity fits a pair, the most similar recipe
    tells by analogy. A model of sets (train-recipes on a book of larger sets, or with --parts)
    also suggests recipes for goals that the book lacks, by their parts and words.

    Args:
        model: model folder from train-recipes.
        pair: what might a + b make? Quote labels with several words.
        goal: entity to make; a model of sets lists known recipes, too.
        with_item: entity that each recipe uses.
        start: comma-separated entities: list what they make, in how many steps, known and likely.
        top: most recipes to list.
        any_parts: also allow ingredients with parts that the goal lacks, or sets that lack a part
            of the goal.
        rule: function of yours, module:function, that allows sets of a model of sets: it takes a
            tuple of ingredients and the goal, and returns True or False.
        out: CSV or TSV file for the suggestions, which build-graph reads; put x into its column
            accept. With --accept, file for the longer book. An existing file is never replaced.
        accept: such a file: write a copy of the book with its ticked recipes to --out.
    """
    from wordcraft_kg.evaluation.suggestions import (
        check_new_table,
        open_suggesting,
        suggest as suggest_for,
        suggest_recipes,
        write_suggestions,
    )
    from wordcraft_kg.models.recipes.records import SetMetrics
    from wordcraft_kg.models.scorers.sets.rules import read_rule

    whole("top", top, 1)
    user_rule = read_rule(rule) if rule else None
    recipe_model = open_suggesting(model, graph)
    book = recipe_model.opened.graph
    if accept is not None:
        if out is None or pair or goal or with_item or start or rule:
            raise ConfigError("`accept` writes a longer book to `out`; give both, and no query.")
        _write_longer_book(book, accept, out, output)
        return
    metrics = recipe_model.metrics
    if any_parts and not isinstance(metrics, SetMetrics):
        raise ConfigError(
            "`any_parts` lifts the rule on parts of a model of sets; this model is of pairs. Leave "
            "it out."
        )
    if out is not None:
        check_new_table(out)
    wish = _read_wish(book, pair, goal, with_item, start)
    if goal is not None:
        view = suggest_recipes(recipe_model, goal, top, has_coverage=not any_parts, rule=user_rule)
    elif user_rule is not None:
        raise ConfigError("`rule` chooses among the sets of a single goal; give `goal` alone.")
    else:
        view = suggest_for(recipe_model, wish, top, has_coverage=not any_parts)
    if not (view.suggestions or view.analogies or view.made):
        raise ConfigError(
            f"nothing is left to propose: {book.name} has all recipes that the model looks at. Ask "
            "for another pair, item or goal."
        )
    lines = list(suggestion_lines(view))
    if isinstance(metrics, SetMetrics) and not any(metrics.fold_top):
        lines.append("In training no unseen goal got a right set: these suggestions are guesses.")
    if out is not None:
        write_suggestions(view.suggestions, out)
        count = counted(len(view.suggestions), "suggestion")
        lines.append(f"wrote {out}: {count}; put x into the column accept, then --accept {out}")
    output.result(view, lines)


def _read_wish(
    book: "RecipeGraph",
    pair: Sequence[str],
    goal: str | None,
    item: str | None,
    start: Sequence[str] | None,
) -> "Wish":
    """Return the wish of the command's options.

    Raises:
        ConfigError: for several wishes, a list without entities, or words that are no pair.
    """
    from wordcraft_kg.evaluation.scores import pieces_of_recipe
    from wordcraft_kg.evaluation.suggestions import Wish

    labels: tuple[str, ...] = ()
    if pair:
        labels, result = pieces_of_recipe(pair, frozenset(book.entities))
        if result is not None:
            raise ConfigError(f"'{' '.join(pair)}' has a result; expected a pair. Use score.")
    table = tuple(split_labels(start or []))
    if start is not None and not table:
        raise ConfigError("`from` has no entity; expected labels between commas. Name one or more.")
    return Wish(goal=goal, item=item, pair=labels, table=table)


def _write_longer_book(book: "RecipeGraph", table: Path, out: Path, output: Output) -> None:
    from wordcraft_kg.evaluation.suggestions import ticked, write_accepted

    recipes = ticked(table, book)
    write_accepted(book, recipes, out)
    lines = [
        f"wrote {out}: {book.num_recipes:,} recipes of {book.name} and "
        f"{len(recipes):,} of {table}   next: {command_line('build-graph', out)}"
    ]
    output.result({"out": str(out), "accepted": recipes}, lines)


def suggestion_lines(view: "Suggestions") -> Iterator[str]:
    """Yield suggestions, or a scored set, as lines of text."""
    if view.new:
        names = ", ".join(f"'{label}'" for label in view.new)
        yield f"{names} not in the graph: scored by parts and words."
    if view.wish.table:
        yield f"known: {counted(view.num_made, 'entity', 'entities')} from these"
        yield from _table(view.made)
        if view.num_made > len(view.made):
            yield f"  ... and {view.num_made - len(view.made):,} more"
        yield "likely, not in the book:"
    if view.combines is not None:
        pair = " + ".join(view.wish.pair)
        yield f"{pair} makes something that the book lacks: probability {view.combines:.3f}"
    if view.suggestions:
        yield from _table(view.suggestions)
    else:
        yield "no answer: nothing is left to propose"
    if view.analogies:
        yield "no known entity fits:"
    for analogy in view.analogies:
        yield f"  {' + '.join(analogy.ingredients)} -> ?   as {_recipe(analogy.like)}"
    if view.trained_on == "full":
        yield "The model was trained on all recipes, test recipes included."


def _table(suggestions: "Sequence[Suggestion]") -> Iterator[str]:
    rows = [("probability", "", "")]
    for suggestion in suggestions:
        place = suggestion.known if suggestion.steps is None else f"step {suggestion.steps}"
        recipe = f"{' + '.join(suggestion.ingredients)} -> {suggestion.result}"
        rows.append((f"{suggestion.probability:>11.3f}", place, recipe))
    heading, *lines = aligned(rows)
    yield heading.rstrip()
    for line, suggestion in zip(lines, suggestions, strict=True):
        yield line
        if suggestion.because:
            supports = (f"{_recipe(near)} ({near.strength:.2g})" for near in suggestion.because)
            yield f"{'':11}  because {', '.join(supports)}"


def _recipe(support: "SetSupport") -> str:
    return f"{' + '.join(support.ingredients)} -> {support.result}"
