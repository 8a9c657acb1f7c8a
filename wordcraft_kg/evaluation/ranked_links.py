"""Ranks of the evaluation triples in a graph by a link predictor."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from wordcraft_kg.base.errors import SplitError
from wordcraft_kg.base.settings import refuse, whole
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import OpenedGraph, TrainedOn
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.train_samples import TrainSample
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.scorers.baselines import FrequencyScorer, NeighbourScorer, VoteScorer
from wordcraft_kg.models.scorers.config import MAX_QUERIES
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.ranking import MIN_TRIPLES, rank_triples, sampled, triple_groups

MAP_LIMIT = 3_000
"""Largest entity count for which all entity pairs are scored, as by the neighbour baseline.

Above it, two tables of float32 scores need more than 72 MB, and sorting them takes seconds.
"""


@dataclass(frozen=True)
class RankedLinks:
    """A scorer's ranks on the evaluation triples of a graph.

    Attributes:
        scorer: the scorer.
        opened: graph and split.
        kg: training graph of the scorer: full, partial or none.
        population: number of evaluation triples, of which the queries may be a sample.
        queries: ranked triples, shape (T, 3).
        ranks: a row for each of 2 T queries: tails of all triples, then heads.
        train_sample: the recipes that the scorer was trained on, and their triples.
        made_by_other_books: labels that other books in the training make; None without another
            book.
    """

    scorer: TripleScorer
    opened: OpenedGraph
    kg: TrainedOn
    population: int
    queries: Ids
    ranks: pd.DataFrame
    train_sample: TrainSample
    made_by_other_books: frozenset[str] | None = None

    @property
    def graph(self) -> RecipeGraph:
        """The recipe graph with the ranked triples."""
        return self.opened.graph

    @property
    def is_full(self) -> bool:
        """Whether the full graph was used in training, so that all evaluation triples are seen."""
        return self.kg == "full"

    @property
    def trained_on(self) -> Ids:
        """The scorer's training triples as ids, shape (T, 3)."""
        return self.train_sample.triples

    @property
    def has_table(self) -> bool:
        """Whether the graph is small enough to score all entity pairs."""
        return self.graph.num_entities <= MAP_LIMIT

    @cached_property
    def table(self) -> NDArray[np.float32]:
        """Scores of all entity pairs, shape (2, E, E): relation, head, tail."""
        tables = [self.scorer.table(relation) for relation in range(len(RELATIONS))]
        return torch.stack(tables).cpu().numpy()

    @property
    def labelled_ranks(self) -> pd.DataFrame:
        """The rank table with labels in place of entity and relation ids, for readers and files."""
        return labelled(self.graph, self.ranks)

    @cached_property
    def clusters(self) -> Ids:
        """Each query's resampling group, see :func:`triple_groups`; shape (2 T,)."""
        split = self.opened.split
        # A triple belongs to the group of a recipe that gives it: a test recipe, unless training
        # has all recipes and all triples are ranked.
        sources = split.is_in("test")
        if self.is_full:
            sources = np.ones(self.graph.num_recipes, dtype=bool)
        # Tails come before heads, so the groups of the triples repeat.
        return np.tile(triple_groups(split, sources, self.queries), 2)

    @cached_property
    def baseline_ranks(self) -> dict[str, pd.DataFrame]:
        """Rank tables of the baselines, which know the scorer's training triples.

        Beside an untrained scorer, baselines know the train recipes.
        """
        known = self.opened.train_sample("partial") if self.kg == "none" else self.train_sample
        scorers: dict[str, TripleScorer] = {"frequency": FrequencyScorer(self.graph, known.triples)}
        # These two need the scores of all pairs.
        if self.has_table:
            scorers["votes"] = VoteScorer(self.graph, known.sets)
            scorers["neighbours"] = NeighbourScorer(self.graph, known.triples)
        return {
            name: rank_triples(scorer, self.queries, self.graph.triples)
            for name, scorer in scorers.items()
        }


def rank_links(
    scorer: TripleScorer,
    opened: OpenedGraph,
    kg: TrainedOn = "partial",
    *,
    train_sample: TrainSample | None = None,
    made_by_other_books: frozenset[str] | None = None,
    max_queries: int = MAX_QUERIES,
    seed: int = 0,
) -> RankedLinks:
    """Rank the evaluation triples in a graph by a scorer.

    For a scorer trained on the partial graph, evaluation triples are the test triples outside
    training. For a scorer trained on the full graph, they are all triples, which measures memory.

    Args:
        scorer: a scorer of the graph.
        opened: graph and split.
        kg: training graph of the scorer: full, partial or none.
        train_sample: the recipes of ``kg`` that the scorer was trained on; None for all of them.
            The evaluation triples do not depend on this sample, so that models of several samples
            are comparable.
        made_by_other_books: labels that other books in the training make; None without another
            book.
        max_queries: most queries to rank, two for each triple of a uniform sample; 0 for all.
        seed: seed of the sample.

    Returns:
        The ranks, with a row for each query.

    Raises:
        ConfigError: if ``max_queries`` is too small for meaningful metrics.
        SplitError: if fewer than 30 triples remain.
        ArtefactError: if a score is not a finite number.
    """
    if whole("max_queries", max_queries, 0) and max_queries < 2 * MIN_TRIPLES:
        raise refuse("max_queries", max_queries, f"0 for all, or {2 * MIN_TRIPLES} or more")
    # Test triples that training contains by way of other recipes are leaks, and left out.
    everything = opened.split.held_out("test")
    if kg == "full":
        triples = opened.graph.triples
        everything = triples[opened.split.is_fact(triples)]
    queries = sampled(everything, max_queries // 2, seed) if max_queries else everything
    if len(queries) < MIN_TRIPLES:
        raise SplitError(_too_few(len(queries), opened, kg))
    ranks = rank_triples(scorer, queries, opened.graph.triples)
    return RankedLinks(
        scorer,
        opened,
        kg,
        len(everything),
        queries,
        ranks,
        train_sample or opened.train_sample(kg),
        made_by_other_books,
    )


def _too_few(count: int, opened: OpenedGraph, kg: TrainedOn) -> str:
    needed = f"a meaningful metric needs at least {MIN_TRIPLES}."
    if kg == "full":
        more = "Use a recipe book with more recipes."
        return f"only {count} triples in the whole graph; {needed} {more}"
    # A smaller ratio helps only if the ratio is not small yet.
    ratio = "or use a recipe book with more recipes"
    if opened.split.config.train_ratio > 0.7:
        ratio = "such as 0.7"
    remedy = f"Build the graph with a smaller `train_ratio`, {ratio}."
    return f"only {count} unseen test triples; {needed} {remedy}"


def labelled(graph: RecipeGraph, ranks: pd.DataFrame) -> pd.DataFrame:
    """Return a rank table with labels in place of entity and relation ids."""
    # Objects: an array of fixed-width strings would copy the longest label's width for each row.
    names = np.array(graph.entities, dtype=object)
    relations = np.array(RELATIONS, dtype=object)
    frame = ranks.copy()
    for column in ("head", "tail", "top"):
        frame[column] = names[frame[column].to_numpy(dtype=np.int64)]
    frame["relation"] = relations[frame["relation"].to_numpy(dtype=np.int64)]
    return frame
