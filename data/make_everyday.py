"""Write the dataset folder of the book `everyday`: recipes with kind and difficulty, and Croissant
metadata.

    python data/make_everyday.py [--check]

The book itself is wordcraft_kg/graphs/books/everyday.csv. entities.csv, judged.csv and README.md
are written by hand. With ``--check`` nothing is written, and the exit code is 1 if something would
be.
"""

import csv
import io
import json
import sys
from collections import Counter
from hashlib import sha256
from pathlib import Path

import mlcroissant as mlc

from wordcraft_kg.graphs import RecipeGraph, layers, open_book
from wordcraft_kg.graphs.library import locate_book

HERE = Path(__file__).parent / "everyday"
COLUMNS = {
    "recipes.csv": {
        "ingredient_a": "an ingredient",
        "ingredient_b": "the other ingredient; the order has no meaning",
        "result": "what both make together",
        "kind": "kind of reasoning: matter, making, part, place, nature, use, tale or wordplay",
        "layer": "depth: rounds of combining everything known until the recipe can be made, from 1",
        "votes_rank": "difficulty: rank of the result among all entities by votes of the other "
        "recipes, ties in half",
    },
    "entities.csv": {
        "entity": "label",
        "category": "one of 30 categories, such as animal or tool",
        "wordnet": "WordNet 3.0 noun synset, an offset; empty if WordNet lists no fitting sense",
    },
    "judged.csv": {
        "ingredient_a": "an ingredient of a test pair",
        "ingredient_b": "the other ingredient",
        "answer": "a model's answer that the book does not list",
        "accepted": "1 if a reader judged the answer sensible, else 0",
        "first": "models with the answer on rank 1, separated by blanks",
        "second": "models with the answer on rank 2",
    },
}
NUMBERS = ("layer", "votes_rank", "accepted")
ABOUT = (
    "A recipe book for commonsense: two everyday things make a third (flour + water -> dough). "
    "Written and judged by language models, with kinds of reasoning, WordNet senses, categories, "
    "difficulty and judged answers of models."
)


def votes_ranks(graph: RecipeGraph) -> list[float]:
    """Rank each recipe's result: one vote of each other recipe that makes an entity from one of the
    two ingredients.
    """
    made: dict[int, Counter[int]] = {entity: Counter() for entity in range(graph.num_entities)}
    for a, b, result in graph.recipes.tolist():
        for ingredient in {a, b}:
            made[ingredient][result] += 1
    ranks = []
    for a, b, result in graph.recipes.tolist():
        votes = made[a] + made[b] if a != b else Counter(made[a])
        votes[result] -= 2 if a != b else 1
        own = votes[result]
        above = sum(count > own for count in votes.values())
        ties = sum(count == own for count in votes.values()) if own else graph.num_entities - above
        ranks.append(above + (ties + 1) / 2)
    return ranks


def recipes_table() -> str:
    """Return recipes.csv."""
    graph = RecipeGraph.from_book(open_book("everyday"))
    depth = layers(graph)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS["recipes.csv"])
    for row, labels, kind, rank in zip(
        graph.recipes.tolist(),
        graph.recipe_labels(),
        graph.kinds or (),
        votes_ranks(graph),
        strict=True,
    ):
        writer.writerow([*labels, kind, 1 + max(depth[row[0]], depth[row[1]]), f"{rank:g}"])
    return out.getvalue()


def canary() -> str:
    """Return the canary line of the book."""
    with locate_book("everyday").path.open(encoding="utf-8") as file:
        return next(line.strip("# \n") for line in file if "canary" in line)


def croissant(files: dict[str, bytes]) -> str:
    """Return Croissant metadata for the files, by name."""
    distribution, records = [], []
    for name, content in files.items():
        distribution.append(
            mlc.FileObject(
                id=name,
                name=name,
                content_url=name,
                encoding_formats=["text/csv"],
                sha256=sha256(content).hexdigest(),
            )
        )
        table = name.removesuffix(".csv")
        fields = [
            mlc.Field(
                id=f"{table}/{column}",
                name=column,
                description=text,
                data_types=mlc.DataType.FLOAT if column in NUMBERS else mlc.DataType.TEXT,
                source=mlc.Source(file_object=name, extract=mlc.Extract(column=column)),
            )
            for column, text in COLUMNS[name].items()
        ]
        records.append(mlc.RecordSet(id=table, name=table, fields=fields))
    metadata = mlc.Metadata(
        name="everyday",
        description=f"{ABOUT} {canary()}",
        license=["https://creativecommons.org/publicdomain/zero/1.0/"],
        url="https://creativecommons.org/publicdomain/zero/1.0/",
        version="2.0.0",
        date_published="2026-11-23",
        creators=[mlc.Organization(name="The wordcraft-kg authors")],
        cite_as="The wordcraft-kg authors: everyday 2, a recipe book for commonsense, 2026.",
        distribution=distribution,
        record_sets=records,
    )
    return json.dumps(metadata.to_json(), indent=2, default=str) + "\n"


def main() -> int:
    """Write or check the generated files."""
    made = {"recipes.csv": recipes_table()}
    others = {name: (HERE / name).read_bytes() for name in COLUMNS if name not in made}
    made["croissant.json"] = croissant(
        {**{name: text.encode() for name, text in made.items()}, **others}
    )
    changed = [
        name
        for name, text in made.items()
        if not (HERE / name).is_file() or (HERE / name).read_text() != text
    ]
    if "--check" in sys.argv[1:]:
        print(
            "\n".join(
                f"{HERE / name} is out of date: python data/make_everyday.py" for name in changed
            )
        )
        return int(bool(changed))
    for name in changed:
        (HERE / name).write_text(made[name])
    return 0


if __name__ == "__main__":
    sys.exit(main())
