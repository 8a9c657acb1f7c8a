"""Does a partial graph help an agent? Scorer x use x distractors x split x book, with leak-free MRR and success.

    python benchmarks/partial_graph.py everyday little-alchemy-2
    python benchmarks/partial_graph.py everyday --splits by-goal --distractors 1 --only "no graph;recipes, u v w"

For each split, ComplEx, a recipe scorer and scorers without learning use the partial graph; all are cross-fitted with
five folds, and "ComplEx, in-sample" is the same ComplEx model with in-sample scores, as in the paper. Success is the
greedy agent's success on test tasks (five distractor seeds); intervals are over trainings, which differ in
split and seed, and differences to no graph pair runs with the same split and seed. Existing results in --out are kept,
so a long run can be interrupted.
"""

import argparse
import json
import multiprocessing
from collections.abc import Container, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.base.statistics import student_interval
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.folder import open_graph

SPLITS = ("by-recipe", "by-slot", "by-goal")
U_V = {"use": "combines,component"}
VARIANTS: dict[str, tuple[str | None, dict[str, object]]] = {
    "no graph": (None, {}),
    "facts, u v": ("facts", U_V),
    "neighbours, u v": ("neighbours", U_V),
    "kernel, u v": ("kernel", U_V),
    "ComplEx in-sample, u v": ("complex", {**U_V, "in_sample": True}),
    "ComplEx, u v": ("complex", U_V),
    "recipes in-sample, u v w": (
        "recipes",
        {"use": "combines,component,recipe", "in_sample": True},
    ),
    "recipes, u v": ("recipes", U_V),
    "recipes, u v w": ("recipes", {"use": "combines,component,recipe"}),
    "recipes, w alone": ("recipes", {"use": "recipe", "kg_only": True}),
}
"""Scorer, and settings of the policy."""


@dataclass(frozen=True)
class Cell:
    """A training."""

    home: Path
    variant: str
    distractors: int
    seed: int
    steps: int

    @property
    def folder(self) -> Path:
        name = f"{self.variant}-{self.distractors}-{self.steps}-{self.seed}".replace(
            " ", "-"
        ).replace(",", "")
        return self.home / "runs" / name


def build(book: str, home: Path, kind: str, seed: int, scorers: Container[str | None]) -> None:
    """Make the graph and these scorers of a split, as far as they are not there."""
    from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split, open_book, open_graph
    from wordcraft_kg.graphs.folder import write_graph_folder
    from wordcraft_kg.models.folder import save_scorer
    from wordcraft_kg.models.links.config import ComplExConfig, LinksConfig
    from wordcraft_kg.models.links.training import train_links
    from wordcraft_kg.models.recipes.config import RecipesConfig
    from wordcraft_kg.models.recipes.training import train_recipes
    from wordcraft_kg.models.scorers.cross_fitting import cross_fit

    graph = home / "graph"
    if not graph.exists():
        recipes = open_book(book)
        write_graph_folder(
            graph, recipes, make_split(RecipeGraph.from_book(recipes), SplitConfig(kind, seed=seed))
        )
    opened = open_graph(graph)
    for name, make in own_scorers(opened.graph).items():
        if name in scorers and not (home / name).exists():
            save_scorer(
                home / name, cross_fit(opened.split, make), opened, kg="partial", origin=name
            )
    if "complex" in scorers and not is_done(home / "complex"):
        train_links(LinksConfig(str(graph), ComplExConfig()), home / "complex", force=True)
    if "recipes" in scorers and not is_done(home / "recipes"):
        train_recipes(RecipesConfig(str(graph)), home / "recipes", force=True)
    figures = home / "mrr.json"
    mrr = json.loads(figures.read_text()) if figures.exists() else {}
    missing = sorted(
        {name for name, _ in VARIANTS.values() if name and name in scorers and name not in mrr}
    )
    write_atomically(figures, json.dumps(mrr | judge(home, missing)))


def own_scorers(graph):  # type: ignore[no-untyped-def]
    """Return what makes each scorer that learns nothing."""
    from wordcraft_kg.graphs.triples import recipe_triples
    from wordcraft_kg.models.scorers.baselines import KernelScorer, NeighbourScorer, SymbolicScorer
    from wordcraft_kg.models.scorers.features import glove_features

    vectors = glove_features(graph.entities).vectors
    return {
        "facts": lambda recipes: SymbolicScorer(graph, recipe_triples(recipes)),
        "neighbours": lambda recipes: NeighbourScorer(graph, recipe_triples(recipes)),
        "kernel": lambda recipes: KernelScorer(graph, recipes, vectors),
    }


def is_done(folder: Path) -> bool:
    """Return whether a finished model is there."""
    from wordcraft_kg.base.errors import ArtefactError
    from wordcraft_kg.runs.record import read_run

    try:
        return read_run(folder).status == "done"
    except ArtefactError:
        return False


def judge(home: Path, scorers: list[str]) -> dict[str, float]:
    """Return the leak-free MRR of these scorers."""
    from wordcraft_kg.models.folder import open_model
    from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples

    found = {}
    for name in scorers:
        model = open_model(home / name)
        graph, split = model.opened.graph, model.opened.split
        found[name] = mean_reciprocal_rank(
            rank_triples(model.scorer, split.held_out("test"), graph.triples)
        )
    return found


def train(cell: Cell) -> float:
    """Train an agent unless the run exists, and return success on test tasks."""
    from wordcraft_kg.agents.config import AgentConfig, ImpalaConfig, TaskConfig
    from wordcraft_kg.agents.training import train_agent
    from wordcraft_kg.models.policies.config import PolicyConfig

    figures = cell.folder.with_suffix(".json")
    if not figures.exists():
        scorer, settings = VARIANTS[cell.variant]
        config = AgentConfig(
            str(cell.home / "graph"),
            None if scorer is None else str(cell.home / scorer),
            TaskConfig(distractors=cell.distractors),
            PolicyConfig(**settings),  # type: ignore[arg-type]
            ImpalaConfig(
                preset="paper",
                steps=cell.steps,
                seed=cell.seed,
                eval_every=0,
                checkpoint_every=cell.steps,
            ),
        )
        trained = train_agent(config, cell.folder, force=True)
        assert trained.summary is not None
        found = {part: success.mean for part, success in trained.summary.success.items()}
        write_atomically(
            figures, json.dumps(found | {"steps_per_second": trained.summary.steps_per_second})
        )
        for file in ("constants.safetensors", "episodes.jsonl"):
            (cell.folder / file).unlink()  # tens of megabytes each
    return float(json.loads(figures.read_text())["test"])


def tasks_of(home: Path) -> int:
    """Return the number of test tasks of a split."""
    opened = open_graph(home / "graph")
    return len(World(opened, WordCraftConfig("test")).tasks)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("books", nargs="+")
    parser.add_argument("--splits", default=",".join(SPLITS))
    parser.add_argument("--split-seeds", type=int, default=3)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--distractors", default="8,1")
    parser.add_argument("--steps", type=int, default=3_000_000)
    parser.add_argument("--only", help="variants, semicolons separate")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/runs/partial-graph"))
    options = parser.parse_args()
    variants = options.only.split(";") if options.only else list(VARIANTS)
    found: list[dict[str, Any]] = []
    distractors = [int(amount) for amount in options.distractors.split(",")]
    for book in options.books:
        for kind in options.splits.split(","):
            homes = [
                options.out / f"{Path(book).stem}-{kind}-{seed}"
                for seed in range(options.split_seeds)
            ]
            for seed, home in enumerate(homes):
                build(book, home, kind, seed, {VARIANTS[variant][0] for variant in variants})
            cells = [
                Cell(home, variant, amount, seed, options.steps)
                for amount in distractors
                for variant in variants
                for home in homes
                for seed in range(options.seeds)
            ]
            context = multiprocessing.get_context("spawn")
            with ProcessPoolExecutor(options.jobs, mp_context=context) as pool:
                success = dict(zip(cells, pool.map(train, cells), strict=True))
            rows = list(rows_of(Path(book).stem, kind, variants, success))
            print("\n".join(lines_of(rows)), flush=True)
            found += rows
    if options.json:
        write_atomically(options.json, json.dumps(found, indent=1) + "\n")


def rows_of(
    book: str, kind: str, variants: list[str], success: dict[Cell, float]
) -> Iterator[dict[str, Any]]:
    """Yield figures by variant and number of distractors."""
    for variant in variants:
        scorer = VARIANTS[variant][0]
        for amount in dict.fromkeys(cell.distractors for cell in success):
            of = [cell for cell in success if (cell.variant, cell.distractors) == (variant, amount)]
            values = [success[cell] for cell in of]
            none = [success.get(replace(cell, variant="no graph"), np.nan) for cell in of]
            mrr = (
                [json.loads((cell.home / "mrr.json").read_text())[scorer] for cell in of]
                if scorer
                else []
            )
            tasks = [tasks_of(cell.home) for cell in of]
            yield {
                "book": book,
                "split": kind,
                "variant": variant,
                "distractors": amount,
                "steps": of[0].steps,
                "trainings": len(of),
                "mrr": round(float(np.mean(mrr)), 4) if mrr else None,
                "success": round(float(np.mean(values)), 4),
                "values": [round(value, 4) for value in values],
                "tasks": tasks,
                "interval": student_interval(values),
                "more_than_no_graph": round(float(np.mean(np.subtract(values, none))), 4),
                "least_more_than_no_graph": round(float(np.min(np.subtract(values, none))), 4),
            }


def lines_of(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield a figure table for a book and a split kind."""
    first = rows[0]
    yield (
        f"\n{first['book']}, {first['split']}: {first['steps']:,} steps, {first['trainings']} "
        "trainings of each"
    )
    amounts = list(dict.fromkeys(row["distractors"] for row in rows))
    yield "".join(
        [
            f"{'':26}{'MRR':>6}",
            *(f"{f'{amount} distractors':>24}{'- none':>9}" for amount in amounts),
        ]
    )
    for variant in dict.fromkeys(row["variant"] for row in rows):
        of = [row for row in rows if row["variant"] == variant]
        line = f"{variant:26}{'' if of[0]['mrr'] is None else format(of[0]['mrr'], '.3f'):>6}"
        for row in of:
            shown = "[{:.3f}, {:.3f}]".format(*row["interval"]) if row["interval"] else ""
            line += f"{row['success']:8.3f} {shown:>15}{row['more_than_no_graph']:>+9.3f}"
        yield line


if __name__ == "__main__":
    main()
