"""Precursors of inorganic materials: the table of docs/evidence/inorganic-synthesis.md.

    wordcraft-kg books --fetch inorganic-synthesis
    python -m benchmarks.inorganic_synthesis --out synthesis --predictions published.json.gz

Each of the five published folds is built, trained on and evaluated in a folder of OUT; what is there
is used again. The table pools the targets of all folds. A fold takes about 75 CPU seconds.

PREDICTIONS holds the published methods' answers and is made by hand: the files
``results/METHOD/top5_random_cvFOLD.json`` of the data's repository, https://github.com/jschrier/SynthGPT
at the commit of the book, packed into one gzipped JSON file ``{method: {fold: {target: sets}}}``,
with folds "1" to "5" and the sets best first. Without it the table has this toolkit's rows alone.
"""

import argparse
import gzip
import json
from collections import defaultdict
from pathlib import Path

import msgspec
import numpy as np

from wordcraft_kg import open_model
from wordcraft_kg.base.records import as_values
from wordcraft_kg.base.statistics import paired_difference, wilson_interval
from wordcraft_kg.evaluation.ranked_sets import RankedSets, rank_sets
from wordcraft_kg.graphs.folder import write_graph_folder
from wordcraft_kg.graphs.library import open_book, published_fold
from wordcraft_kg.graphs.published_splits import read_published_split
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.models.recipes.config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.training import train_recipes

BOOK = "inorganic-synthesis"
PAGE = "inorganic-synthesis"
COLUMNS = {
    "all": "all targets",
    "new parts": "element set not in train",
    "new sets": "precursor set not in train",
}
NAMES = {
    "model": "**sets by parts**, this toolkit",
    "statistics of parts": "coverage and frequent precursors alone",
    "sets of the nearest goal": "precursors of the most similar target",
    "most frequent sets": "most frequent sets",
    "elemwise.json": "ElemwiseRetro (2022)",
    "gpt-3.5_finetune_rescore.json": "GPT-3.5 fine-tuned, rescored (2024)",
    "gpt-4_rescore.json": "GPT-4 zero-shot, rescored (2024)",
    "statistical_baseline.json": "statistics of element and precursor (2024)",
}
SHOWN = (1, 5)


def model_of_fold(fold: int, out: Path) -> Path:
    """Return the folder of a fold's model, trained if it is not there."""
    folder = out / f"model-{fold}"
    if not (folder / "README.md").is_file():
        book = open_book(BOOK)
        graph = RecipeGraph.from_book(book)
        path = published_fold(BOOK, f"fold-{fold}")
        assert path is not None
        source = out / f"fold-{fold}"
        write_graph_folder(source, book, read_published_split(path, graph), force=True)
        settings = RecipeScorerConfig(parts="formulas")
        train_recipes(RecipesConfig(str(source), settings), folder, force=True)
    return folder


def published_files(path: Path | None, fold: int, out: Path) -> list[Path]:
    """Write a file of predictions for each published method, and return the paths."""
    if path is None:
        return []
    with gzip.open(path, "rt", encoding="utf-8") as file:
        methods = json.load(file)
    folder = out / f"published-{fold}"
    folder.mkdir(exist_ok=True)
    for method, folds in methods.items():
        (folder / f"{method}.json").write_text(json.dumps(folds[str(fold)]), encoding="utf-8")
    return sorted(folder.iterdir())


def table(records: list[RankedSets]) -> list[str]:
    """Return the lines of tables.csv: shares of all folds' targets together, with intervals."""
    right: dict[tuple[str, str, int], float] = defaultdict(float)
    goals: dict[tuple[str, str], int] = defaultdict(int)
    for record in records:
        for method in record.methods:
            for column, top in method.columns.items():
                goals[method.name, column] += top.goals
                for k in SHOWN:
                    right[method.name, column, k] += top.shares[k] * top.goals
    lines = []
    for method, name in NAMES.items():
        for column, heading in COLUMNS.items():
            number = goals[method, column]
            for k in SHOWN if number else ():
                share = right[method, column, k] / number
                low, high = wilson_interval(right[method, column, k], number)
                title = f"{heading}: top-{k}"
                lines.append(f'{PAGE},folds,"{name}","{title}",{share:.3f},{low:.3f},{high:.3f}')
    return lines


def leads(out: Path, folds: list[int]) -> list[str]:
    """Return the model's lead over each published method on all targets, with paired intervals."""
    hits: dict[str, list[list[bool]]] = defaultdict(list)
    for fold in folds:
        path = published_fold(BOOK, f"fold-{fold}")
        assert path is not None
        answers = {"model": out / f"predictions-{fold}.json"}
        answers |= {file.name: file for file in (out / f"published-{fold}").glob("*.json")}
        methods = {name: json.loads(file.read_text("utf-8")) for name, file in answers.items()}
        for target, sets in json.loads(path.read_text("utf-8"))["test"].items():
            right = set(map(frozenset, sets))
            for name, predictions in methods.items():
                ranked = list(dict.fromkeys(map(frozenset, predictions.get(target, ()))))
                hits[name].append([not right.isdisjoint(ranked[:k]) for k in SHOWN])
    tables = {name: np.array(rows) for name, rows in hits.items()}
    lines = []
    for name in sorted(tables.keys() - {"model"}):
        for column, k in enumerate(SHOWN):
            pair = (tables[which][:, [column]] for which in ("model", name))
            lead, low, high = paired_difference(*pair, None)
            lines.append(f"lead over {NAMES[name]}, top-{k}: {lead:+.3f} [{low:+.3f}, {high:+.3f}]")
    return lines


def main() -> None:
    """Train, evaluate, and print the lines of the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--predictions", type=Path)
    parser.add_argument("--folds", default="1,2,3,4,5")
    given = parser.parse_args()
    given.out.mkdir(exist_ok=True)
    records = []
    for fold in map(int, given.folds.split(",")):
        path = given.out / f"ranked-{fold}.json"
        if not path.is_file():
            model = open_model(model_of_fold(fold, given.out))
            files = published_files(given.predictions, fold, given.out)
            ranked, predictions = rank_sets(model, "model", files)
            (given.out / f"predictions-{fold}.json").write_text(json.dumps(predictions))
            path.write_text(json.dumps(as_values(ranked)))
        record = msgspec.json.decode(path.read_bytes(), type=RankedSets)
        records.append(record)
        print(f"fold {fold}: calibration error {record.calibration_error:.3f}", flush=True)
    print("\n".join(table(records)))
    print("\n".join(leads(given.out, list(map(int, given.folds.split(","))))))


if __name__ == "__main__":
    main()
