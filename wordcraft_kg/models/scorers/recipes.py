"""Scores for whole recipes, and the train recipes that support a score."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor

from wordcraft_kg.base.tensors import torch_threads
from wordcraft_kg.graphs.triples import COMBINES_WITH
from wordcraft_kg.models.scorers.factors import grids
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.neighbours.pair_features import only_pair
from wordcraft_kg.models.scorers.neighbours.results import CANDIDATES, results_of
from wordcraft_kg.models.scorers.neighbours.storage import check_stored
from wordcraft_kg.models.scorers.protocol import Witness as Witness
from wordcraft_kg.models.scorers.score_limits import has_table
from wordcraft_kg.models.scorers.scorer import EntityIds, StoredScorer

_ROWS = 4_096
"""Recipes scored at once."""
ALL_RESULTS = 50_000
"""Most entities of a book whose entities are all scored as results of a pair.

With 800,000, all scores of a pair would take half a minute.
"""
_MANY = 8
"""With more links than a share of 1 / 8, all links are scored, which is faster, and kept."""


class RecipeScorer(StoredScorer):
    """A learned scorer for recipes and links: small networks (rankers) on recipe features.

    The networks learn from out-of-sample features. Recipe scores are in nats: the log-odds, up to a
    constant, that an ingredient pair makes the goal, given that some pair on the table does. Link
    scores come from the link ranker.

    Attributes:
        kind: ``recipes``, the scorer kind in ``vocabulary.json``.
        shared: tensors that the models of all folds have in common, stored once.
        knowledge: recipes, words and rankers.
        recipes: shape (n, 3), training recipes; none if the scorer learned from other books alone.
    """

    kind: ClassVar[str] = "recipes"
    shared: ClassVar[tuple[str, ...]] = ("num_own", "vectors", "near_words")

    def __init__(
        self,
        tensors: Mapping[str, Tensor],
        entities: Sequence[str],
        graph_hash: str,
        **kwargs: Any,
    ):
        """Take over the stored tensors.

        Args:
            tensors: tensors by name, see :meth:`check`.
            entities: labels in id order.
            graph_hash: content hash of the recipe graph that the ids belong to.
            kwargs: ``device`` and ``name``, as in ``Scorer``.

        Raises:
            KeyError: if a tensor is missing.
            ValueError: if a tensor has another shape or type, or holds an id or number out of
                range.
        """
        super().__init__(entities, graph_hash, **kwargs)
        self.knowledge = RecipeKnowledge(tensors, len(self.entities)).to(self.device)
        self.knowledge.requires_grad_(False)
        self._tables: dict[int, Tensor] = {}
        # Recipes of other books, whose entities have further ids, are no recipes of the graph.
        has_others = len(tensors["vectors"]) > len(self.entities)
        self.recipes = tensors["recipes"][: 0 if has_others else None]

    def tensors(self) -> dict[str, Tensor]:  # noqa: D102 - inherited
        return self.knowledge.constants()

    def factors(self, relation: int | str) -> tuple[Tensor, Tensor]:
        """Return the kernel regression, one of the link ranker's features, as two matrices.

        Entities are compared by their rows where a table of all scores has no room; scores of
        links, also those of agents, are the link ranker's.

        Args:
            relation: relation id or label.

        Returns:
            ``left`` and ``right``, shape (E, m), float32: a pair scores their product.

        Raises:
            UnknownEntityError: for an unknown relation.
        """
        factors = self.knowledge.lists().by_kernel
        is_pair = int(self.relation_ids(relation)) == COMBINES_WITH
        head_factors = factors.pair_left if is_pair else factors.left
        # Without the entities of other books, which come last.
        size = len(self.entities)
        left_factors = torch.from_numpy(head_factors[:size])
        right = torch.from_numpy(factors.right[:size])
        return left_factors.to(self.device), right.to(self.device)

    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        is_grid, is_turned = grids(heads, relations, tails)
        heads, relations, tails = torch.broadcast_tensors(heads, relations, tails)
        shape = heads.shape
        if not (is_grid or is_turned):
            heads, relations, tails = (ids.reshape(-1, 1) for ids in (heads, relations, tails))
        scores = torch.zeros(heads.shape, device=self.device)
        # A row has one relation, and a ranking has millions of columns in all.
        row_relations = relations[:, 0]
        for relation in row_relations.unique().tolist():
            is_own = row_relations == relation
            own_heads = heads[is_own]
            own_tails = tails[is_own]
            if self._has_table(relation, own_heads.numel()):
                scores[is_own] = self.table(relation)[own_heads, own_tails]
            elif is_grid and not is_turned:
                # Rankings ask for all entities, whose links share work.
                scores[is_own] = self.knowledge.link_scores(relation, own_heads[:, 0], own_tails[0])
            else:
                # A row has one tail. Few and small products: further threads would mostly wait.
                key = own_tails[:, 0]
                model = torch.zeros_like(key)
                with torch_threads(1):
                    scores[is_own] = self.knowledge.slot_scores(relation, key, own_heads, model)
        return scores.view(shape)

    def _has_table(self, relation: int, num_scores: int) -> bool:
        """Return whether a look-up in a table of all scores is faster than so many scores."""
        size = len(self.entities)
        return relation in self._tables or (has_table(size) and _MANY * num_scores > size**2)

    def table(self, relation: int | str) -> Tensor:  # noqa: D102 - inherited
        number = int(self.relation_ids(relation))
        if number in self._tables:
            return self._tables[number]
        every = torch.arange(len(self.entities), device=self.device)
        # By rows in memory: sums over a table depend on its order.
        scores = self.knowledge.link_scores(number, every, every).contiguous()
        # Computed once: ranking and calibration ask for many parts of it.
        if has_table(len(self.entities)):
            self._tables[number] = scores
        return scores

    def score_recipes(
        self,
        ingredients: EntityIds,
        others: EntityIds,
        results: EntityIds,
    ) -> Tensor:
        """Score recipes.

        Args:
            ingredients: one entity, a sequence, or an array or tensor of ids of any shape.
            others: the second ingredients; their order does not count.
            results: as ``ingredients``; the three arguments broadcast against each other.

        Returns:
            float32, the broadcast shape, in nats.

        Raises:
            UnknownEntityError: for a label or id that the scorer does not know.
        """
        ids = torch.broadcast_tensors(
            self.entity_ids(ingredients),
            self.entity_ids(others),
            self.entity_ids(results),
        )
        a, b, result = (part.reshape(-1) for part in ids)
        # A recipe is scored as a table of two slots. In one order: rounding would differ between
        # a + b and b + a.
        tables = torch.stack([torch.minimum(a, b), torch.maximum(a, b)], dim=1)
        scores = []
        for goal, table in zip(result.split(_ROWS), tables.split(_ROWS), strict=True):
            pair_scores, _ = self.score_pairs(goal, table, only_pair(self.device))
            scores.append(pair_scores[:, 0])
        return torch.cat(scores).view(ids[0].shape)

    @property
    def proposes_results(self) -> bool:
        """Whether the scorer proposes results of a pair, in place of a score for each entity.

        It does with a pair encoder of its own recipes, and in a book of more than
        :data:`ALL_RESULTS` entities.
        """
        return self.knowledge.has_result_ranker or len(self.entities) > ALL_RESULTS

    def candidate_results(
        self,
        ingredients: Tensor,
        others: Tensor,
        number: int = CANDIDATES,
    ) -> tuple[Tensor, Tensor]:
        """Return results that pairs may make: the proposed ones, best first, or all entities by id.

        Args:
            ingredients: ids, shape (n,).
            others: ids of the second ingredients, shape (n,); their order does not count.
            number: results that neighbours, and that the encoder propose at most.

        Returns:
            ids, shape (n, C), E where there are fewer; and their scores, shape (n, C), float32, in
            nats, -inf likewise. With an encoder they compare results of one pair, and have another
            scale than :meth:`score_recipes`, which compares pairs for a goal.
        """
        if self.proposes_results:
            return results_of(self.knowledge, ingredients, others, number=number)
        size = len(self.entities)
        every = torch.arange(size, device=self.device).expand(len(ingredients), size)
        return every, self.score_recipes(ingredients[:, None], others[:, None], every)

    def score_pairs(
        self, goal: Tensor, table: Tensor, pairs: tuple[Tensor, Tensor] | None = None
    ) -> tuple[Tensor, Tensor]:
        """Score pairs of slots for goals.

        Args:
            goal: ids, shape (B,).
            table: ids in the slots, shape (B, A).
            pairs: first and second slot of P pairs, shape (P,) each; None for all pairs.

        Returns:
            scores in nats, and whether a train recipe makes the goal (0 or 1), shape (B, P) each.
        """
        model = torch.zeros_like(goal)
        features = self.knowledge.features(goal, table, model, pairs)
        scores = self.knowledge.ranker().of_models(features, model)
        return scores, self.knowledge.kinds(features)

    def supporting_recipes(
        self,
        ingredient: str,
        other: str,
        result: str,
        limit: int = 5,
    ) -> list[Witness]:
        """Return training recipes that support a recipe: those for ``result`` first.

        The recipe itself is among them if the model was trained on it.

        Args:
            ingredient: label of an ingredient.
            other: label of the other ingredient.
            result: label of the result.
            limit: maximum number of recipes.

        Raises:
            UnknownEntityError: for a label that the scorer does not know.
        """
        a, b, goal = self.entity_ids([ingredient, other, result]).tolist()
        supports = self.knowledge.supporting_recipes(a, b, goal, limit=limit)
        return [Witness.of(support, self.entities) for support in supports]

    @staticmethod
    def check(tensors: Mapping[str, Tensor], size: int) -> None:  # noqa: D102 - inherited
        check_stored(tensors, size, 1)
