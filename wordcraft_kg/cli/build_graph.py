"""``wordcraft-kg build-graph``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from wordcraft_kg.cli.console import Flag, Output, command_line, refuse_given, split_labels
from wordcraft_kg.cli.graphs import (
    lines_of_graph,
    note_of_shares,
    warn_of_base,
    warn_of_cases,
    warn_of_missing,
)
from wordcraft_kg.cli.options import Base, Book, FileOptions, Force
from wordcraft_kg.graphs.splits import SPLITS, SplitConfig

EXAMPLES = (
    "wordcraft-kg build-graph everyday --out graphs/everyday",
    "wordcraft-kg build-graph recipes.txt --columns item1,item2,product --out graphs/mine",
    "wordcraft-kg build-graph recipes.json --split folds.csv --out graphs/fold-1",
    "wordcraft-kg build-graph inorganic-synthesis --split fold-1 --out graphs/synthesis",
    "wordcraft-kg build-graph everyday --split by-goal --seed 1 --out graphs/everyday-by-goal",
)


def _kinds() -> str:
    return ", ".join(f"{name} ({kind.about})" for name, kind in SPLITS.items())


def build_graph(  # noqa: PLR0913 - parameters are the command's options
    book: Book = "everyday",
    *,
    base: Base = None,
    base_file: Path | None = None,
    split: Annotated[
        str | None,
        Parameter(
            help=f"held-out recipes: {_kinds()}; or a CSV or JSON file with each recipe's or "
            "result's part, or a book's published fold, such as fold-1. "
            "Default: by-recipe, or by-goal if most recipes are the only one of their result."
        ),
    ] = None,
    train_ratio: float = SplitConfig.train_ratio,
    valid_ratio: float = SplitConfig.valid_ratio,
    seed: int = SplitConfig.seed,
    keep_self_results: Flag = False,
    name: str | None = None,
    out: Path | None = None,
    force: Force = False,
    file: FileOptions = FileOptions(),
    output: Output = Output(),
) -> None:
    """Build a graph folder from a recipe book: graph, split, triples and audit.

    Args:
        book: recipe book: a table, lines a + b = c, JSON, a save of Infinite Craft, a folder of
            Minecraft recipes, also in gzip or zip; or a known book's name.
        base_file: text file with one base entity per line.
        train_ratio: training share (pairs, goals or recipe groups), between 0 and 1.
        valid_ratio: validation share; the rest is the test part.
        seed: split seed.
        keep_self_results: keep recipes with an ingredient as the result.
        name: graph name in reports and model folders. Default: the folder's name.
        out: folder to write. Default: graphs/<name>, or graphs/<book's name>.
    """
    from wordcraft_kg.base.artefacts import check_output, with_a_name
    from wordcraft_kg.base.errors import ConfigError
    from wordcraft_kg.graphs.audit import view_build
    from wordcraft_kg.graphs.book_files import book_name
    from wordcraft_kg.graphs.folder import write_graph_folder
    from wordcraft_kg.graphs.library import open_book, published_fold
    from wordcraft_kg.graphs.published_splits import read_published_split
    from wordcraft_kg.graphs.recipe_graph import RecipeGraph
    from wordcraft_kg.graphs.recipes import check_label
    from wordcraft_kg.graphs.splits import default_config, make_split

    recipes = open_book(book, keep_self_results=keep_self_results, **file.for_reading())
    folder = out or Path("graphs") / (name or recipes.name)
    check_output(folder, force=force)
    graph = RecipeGraph.from_book(recipes, _base(base, base_file))
    graph.name = (
        book_name(with_a_name(folder) / "graph.json")
        if name is None
        else check_label(name, "`name`")
    )
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
    warn_of_base(audited)
    warn_of_cases(graph.entities)
    warn_of_missing(graph.entities)
    view = view_build(audited, folder)
    full = ("--kg", "full") if split == "none" else ()
    following = command_line("train-recipes", folder, *full)
    end = f"wrote {folder}/   next: {following}"
    output.result(view, [*lines_of_graph(view), *note_of_shares(audited.split), end])


def _base(base: list[str] | None, base_file: Path | None) -> list[str] | None:
    if base is None and base_file is None:
        return None
    from wordcraft_kg.base.artefacts import read_small_file
    from wordcraft_kg.base.errors import ConfigError

    labels = split_labels(base or [])
    if base_file is not None:
        if not base_file.is_file():
            raise ConfigError(f"--base-file '{base_file}': No such file.")
        try:
            text = read_small_file(base_file).decode("utf-8-sig")
        except UnicodeDecodeError:
            raise ConfigError(f"--base-file {base_file} is not UTF-8 text.") from None
        labels += [line for line in text.splitlines() if line.strip()]
    if not labels:
        raise ConfigError(
            "`base`: the list is empty; name an entity, or leave the option out to infer the base."
        )
    return labels
