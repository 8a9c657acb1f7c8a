"""A split in a few lines of text."""

from typing import TYPE_CHECKING

from wordcraft_kg.cli.console import names

if TYPE_CHECKING:
    from wordcraft_kg.graphs.audit import SplitSummary


def split_rows(split: "SplitSummary") -> list[tuple[str, str]]:
    """Describe a split in a few lines."""
    if split.kind == "none":
        return [("split", "none: every recipe is in train")]
    ratios = [split.train_ratio, split.valid_ratio]
    shares = [*ratios, 1 - sum(ratios)] if ratios[1] else [ratios[0], 1 - ratios[0]]
    sizes = f"{split.train_recipes:,} train"
    sizes += f", {split.valid_recipes:,} validation" if split.valid_recipes else ""
    sizes += f", {split.test_recipes:,} test recipes"
    rows = [
        ("split", f"{split.kind} {'/'.join(f'{share:.0%}' for share in shares)}, seed {split.seed}: {sizes}"),
        ("unseen", f"{split.unseen_triples:,} triples; leaked and left out: {split.leaked_triples:,}"),
    ]
    if split.moved_for_coverage:
        rows.append(("moved", f"{split.moved_for_coverage} recipes to train, to cover every entity"))
    if split.uncovered:
        listed = names(split.uncovered_entities[:5], split.uncovered)
        rows.append(("uncovered", f"{split.uncovered} entities are in no train recipe: {listed}"))
    else:
        rows.append(("covered", "every entity is in a train recipe"))
    if split.pairs_on_both_sides:
        rows.append(("both sides", f"{split.pairs_on_both_sides} pairs have results in more than one part"))
    return rows
