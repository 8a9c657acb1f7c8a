"""Ranks of triples by a link predictor, and link predictors compared on the same queries."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import msgspec
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from wordcraft_kg.base import (
    ConfigError,
    Count,
    GraphMismatchError,
    Record,
    Share,
    SplitError,
    refuse,
    whole,
)
from wordcraft_kg.base.statistics import bootstrap, cluster_interval
from wordcraft_kg.graphs import (
    RELATIONS,
    Ids,
    OpenedGraph,
    PlayedGraph,
    RecipeGraph,
    TrainedOn,
    TrainSample,
)
from wordcraft_kg.models.model import Model
from wordcraft_kg.models.scorers.baselines import FrequencyScorer, NeighbourScorer, VoteScorer
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.ranking import (
    MIN_TRIPLES,
    RankingMetrics,
    rank_triples,
    ranking_metrics,
    sampled,
    triple_groups,
)
from wordcraft_kg.models.scorers.score_limits import MAX_QUERIES

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
    def has_table(self) -> bool:
        """Whether the graph is small enough to score all entity pairs."""
        return self.graph.num_entities <= MAP_LIMIT

    @property
    def sampled_from(self) -> int | None:
        """Number of evaluation triples if the queries are a sample; None if all are ranked."""
        return self.population if self.population > len(self.queries) else None

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
        every_recipe = np.ones(self.graph.num_recipes, dtype=bool)
        sources = every_recipe if self.is_full else split.is_in("test")
        # Tails come before heads, so the groups of the triples repeat.
        return np.tile(triple_groups(split, sources, self.queries), 2)

    @cached_property
    def baseline_ranks(self) -> dict[str, pd.DataFrame]:
        """Rank tables of the baselines, which know the scorer's training triples.

        Beside an untrained scorer, baselines know the train recipes.
        """
        sample = self.opened.train_sample("partial") if self.kg == "none" else self.train_sample
        scorers: dict[str, TripleScorer] = {
            "frequency": FrequencyScorer(self.graph, sample.triples)
        }
        # These two need the scores of all pairs.
        if self.has_table:
            scorers["votes"] = VoteScorer(self.graph, sample.sets)
            scorers["neighbours"] = NeighbourScorer(self.graph, sample.triples)
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
    everything = opened.graph.triples if kg == "full" else opened.split.held_out("test")
    queries = sampled(everything, max_queries // 2) if max_queries else everything
    if len(queries) < MIN_TRIPLES:
        triples = "unseen test triples"
        remedy = "Use a recipe book with more recipes, or a graph with a smaller `train_ratio`."
        if kg == "full":
            triples = "triples in the whole graph"
            remedy = "Use a recipe book with more recipes."
        raise SplitError(
            f"only {len(queries)} {triples}; a meaningful metric needs at least {MIN_TRIPLES}. "
            f"{remedy}"
        )
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


def labelled(graph: RecipeGraph, triples: pd.DataFrame) -> pd.DataFrame:
    """Return a table of triples, or of ranks, with labels in place of entity and relation ids."""
    # Objects: an array of fixed-width strings would copy the longest label's width for each row.
    names = np.array(graph.entities, dtype=object)
    relations = np.array(RELATIONS, dtype=object)
    frame = triples.copy()
    for column in frame.columns.intersection(["head", "tail", "top"]):
        frame[column] = names[frame[column].to_numpy(dtype=np.int64)]
    frame["relation"] = relations[frame["relation"].to_numpy(dtype=np.int64)]
    return frame


Bounds = tuple[float, float]


class ComparedModel(RankingMetrics, kw_only=True):
    """A model's metrics on the shared queries, averaged over seeds.

    Attributes:
        name: the model's name.
        has_seen_the_test_recipes: whether the full graph was used in training, so that the queries
            are no test.
        seeds: training seeds; empty for a model without a recorded seed.
        mrr_of_seeds: MRR with each seed.
        difference: MRR difference to the first model; None for the first model.
        difference_ci: interval of the difference; the intervals of all model pairs hold together
            with 95 % confidence.
    """

    name: str
    has_seen_the_test_recipes: bool
    seeds: tuple[int, ...]
    mrr_of_seeds: tuple[Share, ...]
    difference: float | None = None
    difference_ci: Bounds | None = None


class LinkComparison(Record, omit_defaults=True):
    """Models compared on the same queries; differences are to the first model.

    Attributes:
        graph: the graph and its split.
        unit: recipes, goals, slots or kinds: the split holds these out together, and intervals
            resample them.
        triples: number of ranked unseen triples, that is, test triples outside the training data.
        queries: number of queries, two for each triple.
        pairs: number of model pairs, for which the intervals of differences are corrected
            (Bonferroni).
        models: the models in the order given.
        sampled_from: number of unseen triples if a uniform sample is ranked; None if all are
            ranked.
        best: model with the highest MRR among models that have not seen the test recipes; None
            without such models.
        not_significant: models without a significant difference from `best` at 5 %: the interval
            of the difference contains 0.
    """

    graph: PlayedGraph
    unit: str
    triples: Count
    queries: Count
    pairs: Annotated[int, msgspec.Meta(ge=1)]
    models: Annotated[tuple[ComparedModel, ...], msgspec.Meta(min_length=2)]
    sampled_from: Count | None = None
    best: str | None = None
    not_significant: tuple[str, ...] = ()


def by_mrr(view: LinkComparison) -> list[ComparedModel]:
    """Return the models of a comparison by MRR, best first."""
    return sorted(view.models, key=lambda model: model.mrr or 0.0, reverse=True)


@dataclass(frozen=True)
class Contender:
    """A model to compare.

    Attributes:
        name: the model's name.
        runs: a trained model for each seed, with equal settings.
    """

    name: str
    runs: Sequence[Model]


def compare(contenders: Sequence[Contender]) -> LinkComparison:
    """Compare models by MRR on test triples outside training, with bootstrap intervals.

    All models share the resamples of the groups that the split holds out together, such as recipes
    or goals: a difference on the same queries is far more precise than two separate intervals.
    Reciprocal ranks of a query are averaged over a model's seeds. Intervals cover the choice of
    recipes and say nothing about further seeds.

    Args:
        contenders: two or more models; the first is the reference. Very many triples are sampled.

    Returns:
        Metrics, differences to the first model, and the best model.

    Raises:
        ConfigError: if the seeds of a model were trained with different settings.
        GraphMismatchError: if the models were trained on different graphs or splits.
        SplitError: if the split leaves too few unseen triples.
        ArtefactError: if a score is not a finite number.
    """
    for contender in contenders:
        _check_alike(contenders[0].runs[0], contender)
    # Also of a model of the full graph the test triples are ranked.
    ranked = []
    for contender in contenders:
        links = [
            rank_links(run.scorer, run.opened, max_queries=MAX_QUERIES) for run in contender.runs
        ]
        ranked.append(_averaged(contender, links))
    # All models have the same queries, and so the same clusters.
    shared = links[0]
    clusters = shared.clusters
    pairs = len(contenders) * (len(contenders) - 1) // 2
    # Bonferroni: all intervals hold together at 95 %, whichever pair a reader picks.
    confidence = 1 - 0.05 / pairs

    def interval(values: NDArray[np.float64], level: float = confidence) -> Bounds:
        means = bootstrap(values, clusters)
        return cluster_interval(values, clusters, means, level=level)

    first = ranked[0][1]
    models = []
    for model, values in ranked:
        low, high = interval(values, 0.95)
        # Student's t over few groups may reach below 0, where no MRR lies.
        figures: dict[str, Any] = {"mrr_ci": (max(low, 0.0), high)}
        if values is not first:
            # The same queries in the same order, so reciprocal ranks subtract query by query.
            gain = values - first
            figures |= {"difference": float(gain.mean()), "difference_ci": interval(gain)}
        models.append(msgspec.structs.replace(model, **figures))
    # A model that has seen the test recipes would win by memory.
    fair = [(model.name, values) for model, values in ranked if not model.has_seen_the_test_recipes]
    best = max(fair, key=lambda pair: float(pair[1].mean()), default=None)
    not_significant = []
    for candidate in fair:
        # The best model is ahead by its mean: only the lower end can include 0.
        if best and candidate is not best and interval(best[1] - candidate[1])[0] <= 0:
            not_significant.append(candidate[0])
    return LinkComparison(
        graph=PlayedGraph.of(shared.opened),
        unit=shared.opened.split.unit,
        triples=len(shared.queries),
        queries=len(clusters),
        pairs=pairs,
        sampled_from=shared.sampled_from,
        models=tuple(models),
        best=best[0] if best else None,
        not_significant=tuple(not_significant),
    )


def _check_alike(reference: Model, contender: Contender) -> None:
    for run in contender.runs:
        for input_name, left, right in (
            ("graphs", reference.opened.graph.hash, run.opened.graph.hash),
            ("splits", reference.opened.split.hash, run.opened.split.hash),
        ):
            if left != right:
                raise GraphMismatchError(
                    f"'{reference.scorer.name}' and '{run.scorer.name}' were trained on different "
                    f"{input_name} ({left[:12]}, {right[:12]}); their metrics cannot be compared. "
                    "Train all on the same graph."
                )
        if run.comparable_settings != contender.runs[0].comparable_settings:
            raise ConfigError(
                f"the seeds of '{contender.name}' were trained with different settings; give each "
                "folder as a model."
            )


def _averaged(
    contender: Contender, links: Sequence[RankedLinks]
) -> tuple[ComparedModel, NDArray[np.float64]]:
    """Return a model's metrics and its reciprocal ranks, averaged over the ranks of its seeds."""
    ranks = [run.ranks for run in links]
    metrics = [ranking_metrics(frame) for frame in ranks]
    # Means over seeds of each metric, and no metric of mean ranks, which would favour many seeds.
    means: dict[str, Any] = {}
    for name in ("mrr", "hits_at_1", "hits_at_3", "hits_at_10", "mean_rank", "amri"):
        values = [getattr(seed_metrics, name) for seed_metrics in metrics]
        means[name] = float(np.mean(values))
    # MRR is None only without queries, which compare() refuses.
    model = ComparedModel(
        queries=metrics[0].queries,
        **means,
        name=contender.name,
        has_seen_the_test_recipes=contender.runs[0].kg == "full",
        seeds=tuple(run.seed for run in contender.runs if run.seed is not None),
        mrr_of_seeds=tuple(seed_metrics.mrr or 0.0 for seed_metrics in metrics),
    )
    reciprocal_ranks = [1 / frame["rank"].to_numpy(dtype=float) for frame in ranks]
    return model, np.mean(reciprocal_ranks, axis=0)
