"""``wordcraft-kg evaluate-links``, ``wordcraft-kg score`` and ``wordcraft-kg suggest``."""

import csv
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from wordcraft_kg.base import (
    ConfigError,
    as_values,
    check_output,
    counted,
    dump_json,
    listed,
    nearest,
    staged_folder,
    whole,
    write_atomically,
)
from wordcraft_kg.cli.console import (
    Flag,
    Output,
    aligned,
    check_file,
    check_table,
    command_line,
    split_labels,
    text_table,
    write_file,
    write_table,
)
from wordcraft_kg.cli.options import Force, MovedGraph, Paths, Table, Words
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.scorers.sets.rules import read_rule

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.links import LinkView
    from wordcraft_kg.evaluation.ranked_sets import TopShares
    from wordcraft_kg.evaluation.scores import ScoredAnswer
    from wordcraft_kg.evaluation.suggestions import Suggestion, Suggestions, Wish
    from wordcraft_kg.graphs import RecipeGraph, TrainedOn
    from wordcraft_kg.models.model import Model
    from wordcraft_kg.models.scorers.ranking import RankingMetrics

EXPLAINED = 3
"""Number of answers that are shown with evidence."""
EXAMPLES = {
    "evaluate-links": (
        "wordcraft-kg evaluate-links models/everyday",
        "wordcraft-kg evaluate-links models/everyday --json --force",
    ),
    "score": (
        "wordcraft-kg score models/everyday flour combinesWith water",
        "wordcraft-kg score models/everyday _ componentOf bread --top 5 --new-only",
        "wordcraft-kg score models/everyday --in pairs.csv --out scores.csv",
        "wordcraft-kg score models/everyday-recipes flour + water",
        "wordcraft-kg score models/everyday-recipes _ + water = dough",
    ),
    "suggest": (
        "wordcraft-kg suggest models/everyday-recipes",
        "wordcraft-kg suggest models/everyday-recipes ham + cheese",
        "wordcraft-kg suggest models/everyday-recipes --with-item banana --out suggestions.csv",
        "wordcraft-kg suggest models/everyday-recipes --accept suggestions.csv --out longer.csv",
        "wordcraft-kg suggest models/materials --goal BaTi0.9Zr0.1O3 --top 5 --json",
    ),
}


def evaluate_links(
    model: Path,
    *,
    graph: MovedGraph = None,
    predictions: Paths = None,
    rule: str | None = None,
    out: Path | None = None,
    table: Table = None,
    force: Force = False,
    output: Output = Output(),
) -> int:
    """Evaluate a model on unseen triples and write the report; leaked triples are left out.

    For a model of sets: how often a right set is among the first 1, 3, 5 and 10 for an unseen goal,
    beside baselines and predictions of others. The folder then holds sets.json, and the model's own
    predictions in predictions.json.

    Args:
        model: model folder.
        predictions: for a model of sets, a JSON file with sets of ingredients by goal, best first,
            such as {"mud": [["earth", "water"]]}, perhaps gzipped; may be repeated.
        rule: for a model of sets, function of yours, module:function, that allows sets: it takes a
            tuple of ingredients and the goal, and returns True or False.
        out: folder to write. Default: report/ in the model folder.
    """
    from wordcraft_kg.evaluation.links import view_links
    from wordcraft_kg.evaluation.ranked_links import rank_links
    from wordcraft_kg.evaluation.suggestions import is_set_model
    from wordcraft_kg.models.model_folder import open_model
    from wordcraft_kg.reports.link_report import make_link_report
    from wordcraft_kg.reports.pages import write_report

    check_table(table, force=force)
    folder = out or model / "report"
    trained = open_model(model, graph)
    check_output(folder, force=force)
    if is_set_model(trained):
        _evaluate_sets(trained, model.name, predictions or [], rule, folder, force, output)
        return 0
    if predictions or rule:
        setting = "predictions" if predictions else "rule"
        raise ConfigError(f"`{setting}` is for a model of sets alone. Leave it out.")
    links = rank_links(
        trained.scorer,
        trained.opened,
        trained.kg,
        train_sample=trained.train_sample,
        made_by_other_books=trained.history.made_by_other_books,
    )
    view = view_links(links, name=model.name, provenance=trained.provenance)
    write_report(make_link_report(view, links.labelled_ranks), folder, force=force)
    rows = _rows_of_evaluation(view)
    text = [
        *_notes_of_evaluation(view),
        *text_table(rows),
        *write_table(table, rows, force=force),
        f"wrote {folder}/   open {folder / 'index.html'}",
    ]
    output.result({**as_values(view), "report": str(folder / "index.html")}, text)
    # Coverage depends on the split (by-goal splits lack coverage); if another check fails, no
    # metric is valid.
    failed = [check for check in view.checks if not check.passed and check.id != "coverage"]
    for check in failed:
        print(f"CHECK FAILED: {check.name} ({check.detail})", file=sys.stderr)
    return 1 if failed else 0


def _evaluate_sets(
    trained: "Model",
    name: str,
    predictions: Sequence[Path],
    rule: str | None,
    folder: Path,
    force: bool,
    output: Output,
) -> None:
    """Write the evaluation of a model of sets into a folder, and print it."""
    from wordcraft_kg.evaluation.ranked_sets import rank_sets

    view, ranked = rank_sets(trained, name, predictions, read_rule(rule) if rule else None)
    with staged_folder(folder, force=force) as staging:
        write_atomically(staging / "sets.json", dump_json(as_values(view)))
        write_atomically(staging / "predictions.json", dump_json(ranked))
    rows = []
    for method in view.methods:
        shares = {f"{name} ({top.goals:,})": _shares(top) for name, top in method.columns.items()}
        rows.append({"right set in the first 1, 3, 5, 10": method.name, **shares})
    calibration = f"calibration error {view.calibration_error:.3f} of the first five sets"
    num_goals = view.methods[0].columns["all"].goals
    few = [
        f"{method.name}: answers for {method.answered:,} of {num_goals:,} goals"
        for method in view.methods
        if method.answered < num_goals
    ]
    lines = [*text_table(rows), *few, calibration, f"wrote {folder}/"]
    if view.has_rule:
        lines.append(f"the model's sets are those that {rule} allows")
    if view.trained_on == "full":
        lines.insert(0, "all goals were seen in training: memory, not prediction")
    output.result(view, lines)


def _shares(top: "TopShares") -> str:
    """Format the shares of goals with a right set among the first, with the first's interval."""
    low, high = top.intervals[1]
    shares = " ".join(f"{share:.3f}" for share in top.shares.values())
    return f"{shares} [{low:.3f}, {high:.3f}]"


def _rows_of_evaluation(view: "LinkView") -> list[dict[str, Any]]:
    """Return the table of an evaluation: the model, baselines, and the model on some triples."""
    from wordcraft_kg.evaluation.links import NO_NEAR_SYNONYM

    name = view.model.name
    tables: list[tuple[str, str, RankingMetrics]]
    tables = [(name, part, view.metrics[part]) for part in ("all", *RELATIONS)]
    tables += [(baseline, "all", parts["all"]) for baseline, parts in view.baselines.items()]
    if not view.model.has_seen_the_test_recipes:
        # Recipes that do not nearly repeat a train recipe.
        distant = view.drill_down.get("near_synonyms", {}).get(NO_NEAR_SYNONYM)
        if distant:
            tables.append((name, "no near-synonym", distant))
        by_book = view.drill_down.get("other_book", {})
        tables += [(name, goals, metrics) for goals, metrics in by_book.items()]
    if view.with_leaked:
        tables.append((name, "with leaked", view.with_leaked))
    return [
        {
            "model": model,
            "triples": triples,
            "MRR": metrics.mrr,
            "interval": metrics.mrr_ci,
            "hits@1": metrics.hits_at_1,
            "hits@10": metrics.hits_at_10,
        }
        for model, triples, metrics in tables
    ]


def _notes_of_evaluation(view: "LinkView") -> Iterator[str]:
    ranked = f"{view.triples:,}"
    if view.sampled_from is not None:
        ranked = f"a uniform sample of {view.triples:,} of {view.sampled_from:,}"
    if view.model.has_seen_the_test_recipes:
        yield f"{ranked} triples of the graph, all seen in training: memory, not prediction"
        return
    yield f"{ranked} unseen triples; {view.leaked_left_out:,} leaked ones left out"
    best = view.comparisons[0]
    low, high = best.ci
    lead = f"{best.difference:+.3f} [{low:+.3f}, {high:+.3f}]"
    yield f"{best.verdict} the best baseline, {best.baseline}: {lead}"
    if view.has_few_test_recipes:
        count = f"{view.split.test_recipes:,} test recipes"
        yield f"only {count}: another seed of the split may change the verdict"
    if view.folds:
        left_out = f"MRR {view.folds.mrr:.3f} on train triples left out of training"
        yield f"cross-fitted: {left_out} ({view.folds.in_sample_mrr:.3f} in-sample)"


def score(
    model: Path,
    *query: str,
    top: int = 10,
    new_only: Flag = False,
    queries: Annotated[Path | None, Parameter(name="--in")] = None,
    out: Path | None = None,
    force: Force = False,
    graph: MovedGraph = None,
    output: Output = Output(),
) -> None:
    """Score a triple or a recipe, rank entities for an open slot, or score all queries in a file.

    The output marks each triple or recipe as train, valid, test, or new (not in the book). Models
    with folds also give probabilities for triples outside the training data.

    With a train-recipes model, a + b ranks the results, a + b = c scores a recipe, and
    _ + b = c ranks partners; a model of sets takes a + b + c = d, and _ + _ + _ = d for the best
    sets of three. Answers come with supporting train recipes and a note if in-sample.
    Entities outside the graph are scored by the words in their labels, with a note.

    Args:
        model: model folder.
        query: head, combinesWith or componentOf, and tail, each entity or _ for an open slot, which
            a missing tail is; or a recipe such as a + b = c. Quote labels with blanks or signs, and
            'a + b -> c'. If an entity is called _ (or ?), write ? (or _) for the open slot.
        top: entities to list for an open slot.
        new_only: leave out known triples or recipes.
        queries: CSV or TSV file with head, relation and tail, or with the header
            ingredient_a,ingredient_b,result; an empty cell or _ is an open slot.
        out: CSV or TSV file for the scores of --in. Default: print the scores.
    """
    from wordcraft_kg.evaluation.scores import (
        Scores,
        is_recipe_query,
        parse_query,
        read_queries,
        scoring_of,
        with_new_words,
    )
    from wordcraft_kg.evaluation.suggestions import is_set_model
    from wordcraft_kg.models.model_folder import open_model
    from wordcraft_kg.models.recipes.outside_evidence import OutsideEvidenceFinder

    whole("top", top, 1)
    words = list(query)
    if bool(words) == (queries is not None):
        raise ConfigError(
            "score needs a head, a relation and optionally a tail; a recipe such as a + b; or a "
            "query file with --in."
        )
    if queries is None and out is not None:
        raise ConfigError(
            f"--out {out}: only the scores for a file are written; add a query file with --in."
        )
    loaded = open_model(model, graph)
    if queries is None and is_set_model(loaded) and is_recipe_query(words):
        output.result(*_scored_set(loaded, words, top, new_only=new_only))
        return
    entities = frozenset(loaded.scorer.entities)
    if queries is None:
        query_list = [parse_query(words, entities)]
        if new_only and not query_list[0].is_open:
            raise ConfigError("`new_only` filters a ranking; leave a slot open.")
    else:
        query_list = read_queries(queries, entities)
    outside = OutsideEvidenceFinder.open(model, loaded.opened)
    loaded = with_new_words(loaded, model, query_list, queries)
    check_file(out, force=force)
    scoring = scoring_of(loaded, query_list[0], outside)
    answers = tuple(
        scoring.answers(query_list, top, new_only=new_only, is_explained=queries is None)
    )
    # Scores that go into a file are not printed as well; what qualifies them always is.
    lines = [] if out else list(_lines(answers, len(loaded.scorer.entities)))
    graph_entities = loaded.opened.graph.entities
    new_words = tuple(loaded.scorer.entities[len(graph_entities) :])
    if new_words:
        # A single new entity may be a misspelling that has a vector, too.
        hint = nearest(new_words[0], graph_entities) if len(new_words) == 1 else ""
        labels = listed([f"'{label}'" for label in new_words], most=5)
        lines.append(f"not in the graph, scored by words alone: {labels}.{hint}")
    lines += _notes(loaded.kg, answers)
    printed_answers = answers if out is None else ()
    file = None if out is None else str(out)
    view = Scores(len(query_list), len(answers), loaded.kg, new_words, printed_answers, file)
    if out is not None:
        write_file(out, _table(query_list[0].columns, answers, out), force=force)
        lines.append(f"wrote {out}: {len(answers):,} scores for {len(query_list):,} queries")
    output.result(view, lines)


def _scored_set(
    model: "Model", words: list[str], top: int, *, new_only: bool
) -> "tuple[Suggestions, list[str]]":
    """Return the answer of a model of sets to a recipe, and its lines of text."""
    from wordcraft_kg.evaluation.suggestions import parse_set, score_set, suggest_sets

    ingredients, result, size = parse_set(words, frozenset(model.opened.graph.entities))
    if ingredients and new_only:
        raise ConfigError("`new_only` filters a ranking; leave a slot open.")
    if ingredients:
        view = score_set(model, ingredients, result)
    else:
        view = suggest_sets(model, result, top, size=size, new_only=new_only)
    return view, list(suggestion_lines(view))


def _lines(answers: Sequence["ScoredAnswer"], num_entities: int) -> Iterator[str]:
    from wordcraft_kg.evaluation.scores import because

    if not answers:
        yield "no answer: nothing is left to propose"
        return
    is_recipe = "result" in answers[0].slots
    form = "{} + {} -> {}" if is_recipe else "{} {} {}"
    rows = [
        {
            f"{'score':>9}": f"{answer.score:9.4f}",
            "part": answer.known,
            "recipe" if is_recipe else "triple": form.format(*answer.slots.values()),
            "probability": answer.probability,
            "": "(learned)" if answer.in_sample else None,
        }
        for answer in answers
    ]
    heading, *lines = text_table(rows)
    yield heading
    for number, (line, answer) in enumerate(zip(lines, answers, strict=True)):
        yield line
        # Only the best rows are explained.
        if number < EXPLAINED:
            if answer.because:
                yield f"{'':9}  because {because(answer.because)}"
            for piece in answer.outside:
                yield f"{'':9}  {piece}"
    ranks = answers[0].ranks
    if ranks:
        # Ingredients are told apart by their labels; for a + a, both are one slot.
        roles = {
            answers[0].slots[slot] if slot.startswith("ingredient") else slot: rank
            for slot, rank in ranks.items()
        }
        rank_texts = ", ".join(f"{role} {rank:,}" for role, rank in roles.items())
        yield f"rank among all {num_entities:,} entities, unfiltered: {rank_texts}"


def _notes(kg: "TrainedOn", answers: Sequence["ScoredAnswer"]) -> Iterator[str]:
    from wordcraft_kg.evaluation.scores import BECAUSE

    if any(answer.because for answer in answers):
        yield f"because: {BECAUSE}."
    if any(answer.outside for answer in answers):
        yield (
            "Lines with the name of a source: knowledge from outside the train recipes; in "
            "brackets a table's value."
        )
    if any(answer.in_sample for answer in answers):
        yield (
            "(learned): the scorer was trained on this recipe, so the score is not a prediction."
        )
    if kg == "full" and {"valid", "test"} & {answer.known for answer in answers}:
        yield "The model was trained on the full graph, test triples included."


def _table(slots: Sequence[str], answers: Sequence["ScoredAnswer"], out: Path) -> str:
    """Return answers as the text of a table: TSV or CSV, by the ending of the file."""
    import pandas as pd

    rows = [
        {
            "line": answer.line,
            **answer.slots,
            "score": answer.score,
            "rank": answer.rank,
            "known": answer.known,
            "probability": answer.probability,
            # As in JSON, and as readers in other languages expect.
            "in_sample": str(answer.in_sample).lower(),
        }
        for answer in answers
    ]
    # Each kind of answers has one of the two.
    last = "in_sample" if "result" in slots else "probability"
    frame = pd.DataFrame(rows, columns=["line", *slots, "score", "rank", "known", last])
    is_tsv = out.suffix.lower() in (".tsv", ".tab")
    text: str = frame.to_csv(
        sep="\t" if is_tsv else ",",
        index=False,
        float_format="%.9g",
        lineterminator="\n",
        # Labels hold no tab, so that tables with tabs need no quotes.
        quoting=csv.QUOTE_NONE if is_tsv else csv.QUOTE_MINIMAL,
    )
    return text


# --- suggest -------------------------------------------------------------------------------------


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
    than three, but those that you name. A model of sets (train-recipes on a book of larger sets, or
    with --parts) also suggests recipes for goals that the book lacks, by their parts and words.

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
        table_lines,
        ticked,
        write_accepted,
    )
    from wordcraft_kg.models.recipes.recipe_records import SetMetrics

    whole("top", top, 1)
    user_rule = read_rule(rule) if rule else None
    recipe_model = open_suggesting(model, graph)
    book = recipe_model.opened.graph
    if accept is not None:
        if out is None or pair or goal or with_item or start or rule:
            raise ConfigError("`accept` writes a longer book to `out`; give both, and no query.")
        recipes = ticked(accept, book)
        write_accepted(book, recipes, out)
        line = (
            f"wrote {out}: {book.num_recipes:,} recipes of {book.name} and {len(recipes):,} of "
            f"{accept}   next: {command_line('build-graph', out)}"
        )
        output.result({"out": str(out), "accepted": recipes}, [line])
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
    # The goal of a model of sets lists known recipes, too.
    view = suggest_for(
        recipe_model,
        wish,
        top,
        has_coverage=not any_parts,
        new_only=goal is None,
        rule=user_rule,
    )
    lines = list(suggestion_lines(view))
    if isinstance(metrics, SetMetrics) and not any(metrics.fold_top):
        lines.append("In training no unseen goal got a right set: these suggestions are guesses.")
    if out is not None:
        delimiter = "," if out.suffix.lower() == ".csv" else "\t"
        write_file(out, table_lines(view.suggestions, delimiter), force=False)
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


def suggestion_lines(view: "Suggestions") -> Iterator[str]:
    """Yield suggestions, or a scored set, as lines of text."""
    if view.new:
        names = ", ".join(f"'{label}'" for label in view.new)
        yield f"{names} not in the graph: scored by parts and words."
    if view.wish.table:
        yield f"known: {counted(view.num_made, 'entity', 'entities')} from these"
        yield from _suggestion_rows(view.made)
        if view.num_made > len(view.made):
            yield f"  ... and {view.num_made - len(view.made):,} more"
        yield "likely, not in the book:"
    if view.combines is not None:
        pair = " + ".join(view.wish.pair)
        yield f"{pair} makes something that the book lacks: probability {view.combines:.3f}"
    if view.suggestions:
        yield from _suggestion_rows(view.suggestions)
    else:
        yield "no answer: nothing is left to propose"
    if view.trained_on == "full":
        yield "The model was trained on all recipes, test recipes included."


def _suggestion_rows(suggestions: "Sequence[Suggestion]") -> Iterator[str]:
    yield "probability"
    rows = []
    for suggestion in suggestions:
        place = suggestion.known if suggestion.steps is None else f"step {suggestion.steps}"
        rows.append((f"{suggestion.probability:>11.3f}", place, str(suggestion.recipe)))
    for line, suggestion in zip(aligned(rows), suggestions, strict=True):
        yield line
        if suggestion.because:
            supports = (f"{recipe} ({strength:.2g})" for recipe, strength in suggestion.because)
            yield f"{'':11}  because {', '.join(supports)}"
