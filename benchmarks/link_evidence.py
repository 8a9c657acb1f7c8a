"""Whether the links that are said to speak for a link matter to its score, and which formula says it best.

    python benchmarks/link_evidence.py models/la2-complex models/la2-recipes   # evidence against scores
    python benchmarks/link_evidence.py --delete little-alchemy-2 everyday      # scores without what spoke for them
    python benchmarks/link_evidence.py --retrain little-alchemy-2 everyday     # the same for ComplEx, many at a time

*Against scores*: for the unseen test triples and as many random ones (one end of a test triple exchanged), the rank
correlation (Spearman) of the sum of the evidence and the model's score; among all entities in the open slot of a query,
its mean over 200 queries; and the share of pairs (true, random) that the evidence ranks rightly (AUC), for which it was
not made. The product of the degrees of both ends, which knows no likeness, is the floor.

*Delete*: scorers that need no training are made again without the recipes of the five links that say most for a test
link, without as many random recipes, and without as many random ones of those that have one of both ends. How far the
score falls, in standard deviations of all scores of the relation; means over 100 test links and their standard errors.

*Retrain*: ComplEx is trained again, with its defaults, without what is said to speak for any of 20 links, and without
as many random recipes that have an end of one of these links; five times, with other links. How far the 100 scores
fall, and the mean reciprocal (filtered) ranks; errors are those of the five groups.
"""

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from link_quality import train
from numpy.typing import NDArray
from scipy.stats import spearmanr

from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split, open_book
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.splits import TEST, Draw, Split
from wordcraft_kg.graphs.triples import RELATIONS, is_in, recipe_triples
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.links.config import ComplExConfig
from wordcraft_kg.models.scorers.baselines import NeighbourScorer, VoteScorer
from wordcraft_kg.models.scorers.features import glove_features
from wordcraft_kg.models.scorers.folder import load_scorer
from wordcraft_kg.models.scorers.kernel import KernelScorer
from wordcraft_kg.models.scorers.link_evidence import LinkEvidence
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples
from wordcraft_kg.models.scorers.roles import centred
from wordcraft_kg.models.scorers.scorer import Scorer

QUERIES = 200
LINKS = 100
NAMED = 5
GROUPS = 5

Table = NDArray[np.floating]


def against_scores(folder: Path) -> None:
    model = open_model(folder)
    graph, train = model.opened.graph, model.triples
    for relation, name in enumerate(RELATIONS):
        rng = np.random.default_rng(0)
        scores = model.scorer.table(relation).numpy().astype(np.float64)
        links = np.zeros(scores.shape)
        heads, _, tails = train[train[:, 1] == relation].T
        links[heads, tails] = 1
        true = model.opened.split.held_out("test")
        true = true[true[:, 1] == relation]
        asked = Asked(scores, true, corrupted(true, graph, rng), true[rng.permutation(len(true))[:QUERIES]])
        print(f"{folder.name}, {name}: {len(true):,} true, {len(asked.other):,} random triples")
        print(f"  {'the scores themselves':<28}{asked.figures(scores)}")
        print(f"  {'degrees':<28}{asked.figures((links.sum(1) + 0.1)[:, None] * (links.sum(0) + 0.1))}")
        for title, formula, power in FORMULAS:
            both = [model.scorer.table(other).numpy() for other in range(len(RELATIONS))]
            print(f"  {f'{title}, cos^{power}':<28}{asked.figures(formula(scores, links, power, both))}", flush=True)


@dataclass(frozen=True)
class Asked:
    """A model's scores, and what they are compared on: true and random triples, and queries."""

    scores: Table
    true: Ids
    other: Ids
    queries: Ids

    def figures(self, found: Table) -> str:
        of_true, of_other = (found[rows[:, 0], rows[:, 2]] for rows in (self.true, self.other))
        heads, _, tails = np.concatenate([self.true, self.other]).T
        rho = spearmanr(found[heads, tails], self.scores[heads, tails]).statistic
        within = [spearmanr(found[h], self.scores[h]).statistic for h in self.queries[::2, 0]]
        within += [spearmanr(found[:, t], self.scores[:, t]).statistic for t in self.queries[1::2, 2]]
        return f"{rho:.3f}  within queries {np.nanmean(within):.3f}  AUC {auc(of_true, of_other):.3f}"


def corrupted(true: Ids, graph: RecipeGraph, rng: np.random.Generator) -> Ids:
    """Return triples with a random entity at one end that no recipe gives, as many as there are, or nearly."""
    other = true.copy()
    rows, ends = np.arange(len(true)), rng.choice([0, 2], size=len(true))
    other[rows, ends] = rng.integers(graph.num_entities, size=len(true))
    return other[~is_in(other, graph.triples, graph.num_entities)]


def auc(true: Table, other: Table) -> float:
    above, equal = true[:, None] > other, true[:, None] == other
    return float(np.mean(above + equal / 2))


def cosines(rows: Table) -> Table:
    unit = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12)
    return (unit @ unit.T).clip(0)


def one_end(scores: Table, links: Table, power: float, _: object) -> Table:
    """The evidence of links that share an end: that of the package."""
    return _one_end(cosines(centred(scores)), cosines(centred(scores).T), links, power)


def all_roles(_: Table, links: Table, power: float, both: list[Table]) -> Table:
    """The same with the likeness in all roles together."""
    parts = [part / part.std() for part in map(centred, both)]
    alike = cosines(np.concatenate([side for part in parts for side in (part, part.T)], axis=1))
    return _one_end(alike, alike, links, power)


def uncentred(scores: Table, links: Table, power: float, _: object) -> Table:
    """The same with scores as they are."""
    return _one_end(cosines(scores), cosines(scores.T), links, power)


def both_ends(scores: Table, links: Table, power: float, _: object) -> Table:
    """The evidence of all links, each by the product of how alike both ends are."""
    return cosines(centred(scores)) ** power @ links @ cosines(centred(scores).T) ** power


def _one_end(heads: Table, tails: Table, links: Table, power: float) -> Table:
    others = 1 - np.eye(len(links))
    return (heads**power * others) @ links + links @ (tails**power * others)


FORMULAS: tuple[tuple[str, Callable[[Table, Table, float, list[Table]], Table], int], ...] = (
    *(("one end", one_end, power) for power in (1, 2, 3, 4, 6)),
    *(("one end, all roles", all_roles, power) for power in (1, 3)),
    *(("one end, uncentred", uncentred, power) for power in (1, 3)),
    *(("both ends", both_ends, power) for power in (1, 3, 6)),
)


def deletion(book: str) -> None:
    graph = RecipeGraph.from_book(open_book(book))
    split = make_split(graph, SplitConfig())
    train, vectors = split.recipes("train"), glove_features(graph.entities).vectors
    makers: dict[str, Callable[[Ids], Scorer]] = {
        "recipe kernel": lambda recipes: KernelScorer(graph, recipes, vectors),
        "neighbour rule": lambda recipes: NeighbourScorer(graph, recipe_triples(recipes)),
        "votes": lambda recipes: VoteScorer(graph, recipes),
    }
    for name, make in makers.items():
        scorer = make(train)
        evidence = LinkEvidence(scorer, train)
        rng = np.random.default_rng(0)
        unseen = split.held_out("test")
        falls: dict[str, list[float]] = {"named": [], "random": [], "random, with an end": []}
        deleted = []
        for head, relation, tail in unseen[rng.permutation(len(unseen))].tolist():
            if len(deleted) == LINKS:
                break
            triples, weights = evidence.weights(head, relation, tail)
            order = np.argsort(-weights, kind="stable")[:NAMED]
            named = {int(row) for i in order for row in evidence.recipes_of(*triples[i].tolist())}
            near = np.flatnonzero((train == head).any(axis=1) | (train == tail).any(axis=1))
            if not named or len(near) < 2 * len(named):
                continue
            deleted.append(len(named))
            scale = float(scorer.table(relation).std())
            sets = {
                "named": np.array(sorted(named)),
                "random": rng.choice(len(train), len(named), replace=False),
                "random, with an end": rng.choice(near, len(named), replace=False),
            }
            before = float(scorer.score(head, relation, tail))
            for what, rows in sets.items():
                after = float(make(np.delete(train, rows, axis=0)).score(head, relation, tail))
                falls[what].append((before - after) / scale)
        print(f"{book}, {name}: {len(deleted)} links, {np.mean(deleted):.1f} recipes deleted for each")
        for what, values in falls.items():
            error = np.std(values, ddof=1) / len(values) ** 0.5
            print(f"  {what:<22} falls by {np.mean(values):+.2f} ± {error:.2f}", flush=True)
        ahead = np.mean(np.array(falls["named"]) > np.array(falls["random, with an end"]))
        print(f"  named fall further than random ones with an end: {ahead:.0%}")


def retraining(book: str, folder: Path) -> None:
    graph = RecipeGraph.from_book(open_book(book))
    split = make_split(graph, SplitConfig())
    recipes, rows = split.recipes("train"), np.flatnonzero(split.is_in("train"))

    def trained(deleted: Ids) -> Scorer:
        parts = split.parts.copy()
        parts[rows[deleted]] = TEST
        without = Split(graph, split.config, Draw(parts, split.moved_for_coverage))
        return load_scorer(train(without, ComplExConfig(), folder).folder)

    whole = trained(np.array([], dtype=np.int64))
    evidence = LinkEvidence(whole, recipes)
    rng = np.random.default_rng(0)
    unseen = split.held_out("test")
    found: dict[str, list[list[float]]] = {"named": [], "random, with an end": []}
    for links in np.split(unseen[rng.permutation(len(unseen))[:LINKS]], GROUPS):
        named: set[int] = set()
        near: set[int] = set()
        for head, relation, tail in links.tolist():
            triples, weights = evidence.weights(head, relation, tail)
            for i in np.argsort(-weights, kind="stable")[:NAMED]:
                named |= set(evidence.recipes_of(*triples[i].tolist()).tolist())
            near |= set(np.flatnonzero((recipes == head).any(axis=1) | (recipes == tail).any(axis=1)).tolist())
        others = rng.choice(sorted(near - named), len(named), replace=False)
        before = judged(whole, graph, links)
        for what, deleted in (("named", np.array(sorted(named))), ("random, with an end", others)):
            after = judged(trained(deleted), graph, links)
            found[what].append([len(named), *before, *after])
    for what, values in found.items():
        deleted, score, rank, new_score, new_rank = np.array(values).T
        falls = score - new_score
        error = np.std(falls, ddof=1) / len(falls) ** 0.5
        shown = " ".join(f"{fall:+.2f}" for fall in falls)
        print(
            f"{book}, ComplEx, {what:<20} {deleted.mean():.0f} recipes deleted: scores fall by {falls.mean():+.2f} "
            f"± {error:.2f} ({shown}), MRR {rank.mean():.3f} -> {new_rank.mean():.3f}",
            flush=True,
        )


def judged(scorer: Scorer, graph: RecipeGraph, links: Ids) -> tuple[float, float]:
    """Return the mean score of links in standard deviations of their relations, and their mean reciprocal rank."""
    scores = [float(scorer.score(h, r, t)) / float(scorer.table(r).std()) for h, r, t in links.tolist()]
    return float(np.mean(scores)), mean_reciprocal_rank(rank_triples(scorer, links, graph.triples))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="+", help="model folders, or with --delete or --retrain books")
    parser.add_argument("--delete", action="store_true")
    parser.add_argument("--retrain", action="store_true")
    arguments = parser.parse_args()
    for what in arguments.what:
        if arguments.delete:
            deletion(what)
        elif arguments.retrain:
            with tempfile.TemporaryDirectory() as folder:
                retraining(what, Path(folder))
        else:
            against_scores(Path(what))


if __name__ == "__main__":
    main()
