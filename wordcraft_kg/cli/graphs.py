"""Recipe books and graphs: ``books``, ``check-book``, ``build-graph``, ``describe``, ``export``."""

import logging
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from wordcraft_kg.base import (
    MAX_SIZE,
    ConfigError,
    as_values,
    check_output,
    check_output_file,
    counted,
    listed,
    quoted,
    whole,
    with_a_name,
)
from wordcraft_kg.cli.console import (
    Flag,
    Output,
    aligned,
    command_line,
    lines_of,
    refuse_given,
    split_labels,
    text_table,
)
from wordcraft_kg.cli.failures import with_options
from wordcraft_kg.cli.options import Base, Book, FetchableBook, FileOptions, Force, Graph
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.evaluation.books import (
    CheckedBook,
    ListedBook,
    TaskListing,
    view_books,
    view_check,
    view_tasks,
)
from wordcraft_kg.graphs import (
    SPLITS,
    RecipeGraph,
    SplitConfig,
    TaskPart,
    audit,
    make_split,
    open_book,
    open_graph,
    write_graph_folder,
)
from wordcraft_kg.graphs.audit import Audit, EntityView, view_entity
from wordcraft_kg.graphs.book_files import book_name
from wordcraft_kg.graphs.export import EXPORTERS, ExportPart, Format, export_graph
from wordcraft_kg.graphs.library import (
    DATA_VARIABLE,
    FETCHABLE,
    data_folder,
    fetch_book,
    published_fold,
)
from wordcraft_kg.graphs.planner import derivation_tree
from wordcraft_kg.graphs.splits import default_config, read_published_split

EXAMPLES = {
    "books": (
        "wordcraft-kg books",
        "wordcraft-kg books --fetch little-alchemy-2",
        "wordcraft-kg books --fetch infinite-craft",
        "wordcraft-kg books --fetch inorganic-synthesis",
    ),
    "check-book": (
        "wordcraft-kg check-book recipes.csv",
        "wordcraft-kg check-book recipes.csv --fix mended.csv",
    ),
    "describe": (
        "wordcraft-kg describe everyday",
        "wordcraft-kg describe graphs/everyday --entity bread",
        "wordcraft-kg describe everyday --tasks --depth 2 --distractors 4 --part test --limit 5",
    ),
    "export": (
        "wordcraft-kg export graphs/everyday --format graphml --out everyday.graphml",
        "wordcraft-kg export graphs/everyday --format tsv --part partial --out train.tsv",
        "wordcraft-kg export everyday --format sentences --part partial --out sentences.txt",
    ),
    "build-graph": (
        "wordcraft-kg build-graph everyday --out graphs/everyday",
        "wordcraft-kg build-graph recipes.txt --columns item1,item2,product --out graphs/mine",
        "wordcraft-kg build-graph recipes.json --split fold-1.json --out graphs/fold-1",
        "wordcraft-kg build-graph inorganic-synthesis --split fold-1 --out graphs/synthesis",
        "wordcraft-kg build-graph everyday --split by-goal --seed 1 --out graphs/everyday-by-goal",
    ),
}
_KINDS = ", ".join(f"{name} ({kind.about})" for name, kind in SPLITS.items())
"""The kinds of splits, for the help."""
_MOST_FINDINGS = 10  # of a kind, in the text of check-book


def books(*, fetch: FetchableBook = None, output: Output = Output()) -> None:
    """List the recipe books known by name, or download a published book into the cache.

    Commands accept a book's name in place of a path.

    Args:
        fetch: book to download into the cache; the SHA-256 is checked.
    """
    # The only command that downloads a book: all others work without a network.
    if fetch is not None:
        path = fetch_book(fetch)
        book = FETCHABLE[fetch]
        values = {
            "book": fetch,
            "path": str(path),
            "sha256": book.sha256,
            "url": book.url,
            "note": book.note,
        }
        output.result(
            values,
            [f"{fetch} is in {path} ({book.note})", f"next: wordcraft-kg build-graph {fetch}"],
        )
    else:
        books = view_books()
        output.result({"books": books}, _text_of_books(books))


def _text_of_books(books: Sequence[ListedBook]) -> Iterator[str]:
    rows = []
    for book in books:
        # A built-in book is in the package, wherever that is.
        place = ""
        if book.origin != "built in":
            place = book.path or f"get it: wordcraft-kg books --fetch {book.name}"
        row = {
            "book": book.name,
            "origin": book.origin,
            "entities": book.entities,
            "recipes": book.recipes,
            "": f"{place}  ({book.note})".lstrip() if book.note else place,
        }
        rows.append(row)
    yield from text_table(rows)
    yield "with invented words: made-up:BOOK, such as made-up:everyday; made-up-3:BOOK with seed 3"
    folder = data_folder() or "not set"
    yield f"your own: any path, or files in the folder that {DATA_VARIABLE} names ({folder})"


def check_book(
    book: Book,
    *,
    base: Base = None,
    fix: Path | None = None,
    force: Force = False,
    file: FileOptions = FileOptions(),
    output: Output = Output(),
) -> int:
    """Check a recipe book.

    List problems and notes with line numbers, the first ten of each kind, and count recipes and
    entities. The JSON lists all findings.

    The file itself is not changed. The exit code is 1 if there are problems; notes are no
    failures.

    Args:
        book: recipe book: a table, lines a + b = c, JSON, a save of Infinite Craft, a folder of
            Minecraft recipes, also in gzip or zip; or a known book's name.
        fix: write the mended book to this .csv, .tsv or .json file: readable recipes, each once,
            without results among their ingredients, in UTF-8 and the file's order, tables with
            further columns; what is left out is printed.
    """
    if fix is not None:
        check_output_file(fix, force=force, setting="fix")
    labels = split_labels(base) if base else None
    view = view_check(book, labels, fix=fix, **file.for_reading())
    output.result(view, _text_of_check(view))
    return 0 if view.passed else 1


def _left_out(view: CheckedBook) -> Iterator[str]:
    """Yield what the mended book lacks: rows by reason with their places, and columns."""
    assert view.reading is not None
    for reason, places in view.left_out.items():
        number = view.reading.left_out[reason]
        at = f" (at {listed([*map(str, places)], total=number)})" if places else ""
        yield f"left out: {counted(number, 'row')} {reason}{at}"
    if view.columns_left_out:
        yield f"left out: the columns {', '.join(view.columns_left_out)}"


def _text_of_check(view: CheckedBook) -> Iterator[str]:
    if view.reading is not None:
        yield view.reading.line()
    # The limit is one of each kind, or a thousand repetitions would hide a single fault.
    counts: Counter[str] = Counter()
    for finding in view.findings:
        kind = f"{finding.severity} [{finding.kind}]"
        counts[kind] += 1
        if counts[kind] <= _MOST_FINDINGS:
            # A finding about the whole file has no lines.
            noun = "line" if len(finding.lines) == 1 else "lines"
            where = f"{noun} {', '.join(map(str, finding.lines))}: " if finding.lines else ""
            yield f"{kind} {where}{with_options(finding.message)}"
    # Kinds that were cut say so after all findings, where the eye ends.
    for kind, number in counts.items():
        if number > _MOST_FINDINGS:
            yield f"{kind} and {number - _MOST_FINDINGS:,} more; --json lists them"

    figures = as_values(view.figures)
    # The base is what a user has to see as a whole: a slip in a label makes a base entity.
    if figures.get("base"):
        figures["base"] = ", ".join(map(quoted, figures["base"]))
    has_sets = view.reading is not None and bool(view.reading.arities.keys() - {"2"})
    yield from lines_of(figures, of_sets=has_sets)
    if view.fixed is not None:
        yield f"wrote the mended book to {view.fixed}"
        yield from _left_out(view)
    problems = sum(finding.severity == "problem" for finding in view.findings)
    notes = len(view.findings) - problems
    yield f"{counted(problems, 'problem')}, {notes:,} to look at"


def build_graph(  # noqa: PLR0913 - parameters are the command's options
    book: Book = "everyday",
    *,
    base: Base = None,
    split: Annotated[
        str | None,
        Parameter(
            help=f"held-out recipes: {_KINDS}; or a JSON file with each recipe's or result's "
            "part, or a book's published fold, such as fold-1. Default: by-recipe, or "
            "by-goal if most recipes are the only one of their result."
        ),
    ] = None,
    train_ratio: float = SplitConfig.train_ratio,
    valid_ratio: float = SplitConfig.valid_ratio,
    seed: int = SplitConfig.seed,
    keep_self_results: Flag = False,
    out: Path | None = None,
    force: Force = False,
    file: FileOptions = FileOptions(),
    output: Output = Output(),
) -> None:
    """Build a graph folder from a recipe book: graph, split, triples and audit.

    Args:
        book: recipe book: a table, lines a + b = c, JSON, a save of Infinite Craft, a folder of
            Minecraft recipes, also in gzip or zip; or a known book's name.
        train_ratio: training share (pairs, goals or recipe groups), between 0 and 1.
        valid_ratio: validation share; the rest is the test part.
        seed: split seed.
        keep_self_results: keep recipes with an ingredient as the result.
        out: folder to write, whose name is the graph's. Default: graphs/<book's name>.
    """
    recipes = open_book(book, keep_self_results=keep_self_results, **file.for_reading())
    folder = out or Path("graphs") / recipes.name
    check_output(folder, force=force)
    labels = split_labels(base) if base is not None else None
    if labels == []:
        raise ConfigError(
            "`base`: the list is empty; name an entity, or leave the option out to infer the base."
        )
    graph = RecipeGraph.from_book(recipes, labels)
    graph.name = book_name(with_a_name(folder) / "graph.json")
    fold = None if split is None else published_fold(str(book), split)
    split = split if fold is None else str(fold)
    # With an ending it is meant to be a file, even if there is none of this name.
    if split is not None and split not in SPLITS and (Path(split).suffix or Path(split).is_file()):
        if not Path(split).is_file():
            raise ConfigError(f"--split '{split}': No such file.")
        drawn = SplitConfig(SplitConfig.kind, train_ratio, valid_ratio, seed)
        refuse_given(drawn, "splits that are drawn, not for files")
        partition = read_published_split(Path(split), graph, fold=file.case == "fold")
    else:
        kind = default_config(graph).kind if split is None else split
        partition = make_split(graph, SplitConfig(kind, train_ratio, valid_ratio, seed))
    audited = write_graph_folder(folder, recipes, partition, force=force)
    _warn(audited)
    full = ("--kg", "full") if split == "none" else ()
    following = command_line("train-recipes", folder, *full)
    lines = [*lines_of_build(audited), f"wrote {folder}/   next: {following}"]
    output.result({"out": str(folder), **as_values(audited)}, lines)


@dataclass(frozen=True)
class ListedTaskOptions:
    """Options of --tasks.

    Attributes:
        depth: recipes in the shortest plan, 1 to 5.
        distractors: distractors on the table.
        part: train (all plans use train recipes only), test (each plan uses a test recipe), valid,
            or all.
        limit: tasks to show; with 0, only count.
        seed: seed for the order and the tables of the examples.
    """

    depth: int = WordCraftConfig.depth
    distractors: int = WordCraftConfig.num_distractors
    part: TaskPart = WordCraftConfig.part
    limit: int = 20
    seed: int = 0


def describe(
    graph: Graph,
    *,
    entity: str | None = None,
    tasks: Flag = False,
    options: Annotated[
        ListedTaskOptions, Parameter(name="*", group="Options of --tasks")
    ] = ListedTaskOptions(),
    output: Output = Output(),
) -> None:
    """Audit a graph: ambiguity, reachability, layers, degrees, coverage, leaks.

    Or show an entity, or the graph's tasks.

    Args:
        entity: show this entity's recipes, uses and cheapest derivation instead.
        tasks: count the tasks instead, and show examples with tables and all plans.
    """
    if tasks:
        if entity is not None:
            raise ConfigError("`entity` and `tasks` show different things; give one of them.")
        # Before the search for tasks, which takes long at great depths.
        whole("limit", options.limit, 0, MAX_SIZE)
        whole("seed", options.seed, 0, MAX_SIZE)
        config = WordCraftConfig(options.part, options.depth, options.distractors)
        listing = view_tasks(World.open(graph, config), options.limit, options.seed)
        output.result(listing, _text_of_tasks(listing))
        return
    refuse_given(options, "tasks, with --tasks")

    opened = open_graph(graph)
    if entity is not None:
        view = view_entity(opened.graph, entity)
        output.result(view, _entity_text(view))
        return
    audited = audit(opened.graph, opened.split)
    _warn(audited)
    title = f"graph {opened.graph.name}"
    output.result(audited, [title, *lines_of(audited, of_sets=audited.sets is not None)])


def lines_of_build(view: Audit) -> Iterator[str]:
    """Yield the figures to check after a build as text; ``describe`` prints all others."""
    split = view.split
    sources = "pairs" if view.sets is None else "ingredient sets"
    base = listed([*map(quoted, view.base)], most=5)
    reachable = view.reachability.reachable
    origin = f"seed {split.seed}" if split.published is None else split.published.file
    moved = ""
    if split.moved_for_coverage:
        # So the shares are not those of the settings; by-recipe-plain moves none.
        moved = f"; {split.moved_for_coverage:,} moved to train, so that it has every entity"
    rows = [
        ("entities", f"{view.entities:,}; {reachable:,} in reach of the base: {base}"),
        ("recipes", f"{view.recipes:,}, from {view.pairs:,} different {sources}"),
        (
            "links",
            f"{view.triples.total:,} = {view.triples.combines_with:,} combinesWith + "
            f"{view.triples.component_of:,} componentOf",
        ),
        ("split", f"{split.kind}, {origin}; {split.valid_recipes:,} recipes for validation{moved}"),
        ("train", f"{split.train_recipes:,} recipes, without {split.uncovered:,} of the entities"),
    ]
    if split.test_recipes:
        goals = f"{split.test_goals_in_train:,} of them also by a train recipe"
        rows += [
            ("test", f"{split.test_recipes:,} recipes for {split.test_goals:,} goals, {goals}"),
            (
                "test links",
                f"{split.evaluated_triples:,} asked; {split.leaked_triples:,} left out, because "
                "train recipes have them too",
            ),
        ]
    if view.reading is not None:
        yield view.reading.line()
    yield from aligned(rows)


def _warn(audited: Audit) -> None:
    """Warn about the base, unreachable entities, and labels that may be slips."""
    warn = logging.getLogger(__name__).warning
    base = listed([*map(quoted, audited.base)])
    remedy = "Name the base in the book (# base: a, b) or with build-graph --base."
    # Everything else is counted from the base, so a wrong guess spoils all numbers.
    if not audited.base:
        warn(
            "no entity lacks a recipe, so no base can be inferred and nothing can be made. %s",
            remedy,
        )
    elif audited.base_is_inferred:
        warn(
            "no base is named, so the base is the %s without a recipe: %s. %s",
            counted(len(audited.base), "entity", "entities"),
            base,
            remedy,
        )
    unreachable = audited.reachability.unreachable
    if audited.base and unreachable:
        names = listed([*map(quoted, audited.reachability.unreachable_entities)], total=unreachable)
        number = f"{unreachable:,} of {audited.entities:,}"
        warn("%s entities cannot be made from the base (%s): %s", number, base, names)
    # A chat bot lists results as Lava and ingredients as lava: then half of the recipes are out of
    # reach, and nothing else names the cause.
    if audited.labels.alike:
        groups = [" and ".join(map(quoted, group)) for group in audited.labels.alike_labels]
        warn(
            "%s of labels are alike: %s. If labels differ only in case and are the same thing, "
            "read the book with --case fold.",
            counted(audited.labels.alike, "group"),
            listed(groups, total=audited.labels.alike),
        )


def _entity_text(view: EntityView) -> Iterator[str]:
    place = "base entity" if view.base else "cannot be made from the base"
    if view.layer is not None and not view.base:
        place = f"first made in round {view.layer}"
    yield f"{view.entity}: {place}"
    # Recipes that make the entity, then recipes that use it.
    for title, recipes in (("recipes", view.recipes), ("uses", view.uses)):
        yield f"{title} ({len(recipes)})"
        yield from (f"  {recipe}" for recipe in recipes)
    if view.derivation and view.derivation.steps:
        yield f"cheapest derivation ({len(view.derivation.steps)})"
        yield from (f"  {line}" for line in derivation_tree(view.entity, view.derivation.steps))


def _text_of_tasks(view: TaskListing) -> Iterator[str]:
    # Counts as names and values; the examples follow in a form of their own.
    counts = {name: getattr(view, name) for name in view.__struct_fields__ if name != "shown"}
    yield from lines_of(counts)
    for task in view.shown:
        rows = []
        for name in ("start", "distractors", "table"):
            rows.append((f"  {name}", ", ".join(map(quoted, getattr(task, name))) or "none"))
        rows += [("  plan", "; ".join(map(str, plan))) for plan in task.plans]
        yield from ("", task.goal, *aligned(rows))


def export(
    graph: Graph,
    *,
    format: Format,
    out: Annotated[Path, Parameter(name=["--out"])],
    part: ExportPart = "full",
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Export a graph to other tools' formats.

    Args:
        format: tsv or parquet (triples), graphml (with recipe nodes), csv or json (recipe
            book), hif (JSON of a directed hypergraph), sentences (text for language models, one
            line for each recipe).
        out: file to write.
        part: full (all recipes), partial (train recipes), or unseen (held-out recipes, and triples
            that no train recipe gives). Entities and base are always complete.
    """
    opened = open_graph(graph)
    export_graph(opened, format, out, part=part, force=force)
    values = {
        "graph": opened.graph.name,
        "hash": opened.graph.hash,
        "format": format,
        "part": part,
        "out": str(out),
    }
    output.result(values, [f"wrote {out}: {EXPORTERS[format].about}; part: {part}"])
