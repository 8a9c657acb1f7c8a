"""A split in a few lines of text."""

from typing import TYPE_CHECKING

from wordcraft_kg.base.wording import counted
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
    sizes += f", {counted(split.test_recipes, 'test recipe')}"
    rows = [
        ("split", f"{split.kind} {'/'.join(f'{share:.0%}' for share in shares)}, seed {split.seed}: {sizes}"),
        ("unseen", f"{counted(split.unseen_triples, 'triple')}; leaked and left out: {split.leaked_triples:,}"),
    ]
    goals, test = (max(number, 1) for number in (split.test_goals, split.test_recipes))
    known = f"{split.test_goals_in_train / goals:.0%} of {counted(split.test_goals, 'test goal')} made in train"
    share = f"{split.one_ingredient_away / test:.0%} of the test recipes"
    rows.append(("near train", f"{known}; {share} share an ingredient and the result with a train recipe"))
    if split.moved_for_coverage:
        rows.append(("moved", f"{counted(split.moved_for_coverage, 'recipe')} to train, to cover every entity"))
    if split.uncovered:
        who = counted(split.uncovered, "entity is", "entities are")
        listed = names(split.uncovered_entities[:5], split.uncovered)
        rows.append(("uncovered", f"{who} in no train recipe: {listed}"))
    else:
        rows.append(("covered", "every entity is in a train recipe"))
    if split.pairs_on_both_sides:
        who = counted(split.pairs_on_both_sides, "pair has", "pairs have")
        rows.append(("both sides", f"{who} results in more than one part"))
    return rows
