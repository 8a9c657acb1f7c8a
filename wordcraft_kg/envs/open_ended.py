"""The open-ended game: discover entities, without a goal."""

from collections.abc import Iterable

from wordcraft_kg.base import ConfigError, UnknownEntityError, quoted
from wordcraft_kg.graphs import layers
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph, outcomes_of


class Discovery:
    """The state of an open-ended game: known entities and tried pairs.

    Combining two known entities makes all results of the pair known; nothing is used up.

    Attributes:
        base: ids known at the start, ascending.
        reachable: number of entities that can become known, including the base.
        known: all known ids in order of discovery, as the keys of a dictionary without values.
        tried: the combined pairs ``(a, b)`` with ``a <= b``.

    Example:
        >>> graph = open_graph("everyday").graph
        >>> game = Discovery(graph)
        >>> new, repeated = game.combine(graph.id_of("water"), graph.id_of("earth"))
        >>> graph.labels(new), repeated
        (('mud',), False)
    """

    def __init__(self, graph: RecipeGraph, base: Iterable[Entity] | None = None):
        """Prepare a game on a graph.

        Args:
            graph: recipe graph.
            base: known ids or labels instead of the graph's base entities.

        Raises:
            ConfigError: if an entity of the base is unknown, or nothing can be made from the base.
            GraphError: if a recipe has more than two ingredients, or one.
        """
        # A GraphError for a graph of larger sets: an action names two entities.
        self._outcomes = outcomes_of(graph.recipes, graph.num_entities)
        try:
            if base is None:
                base = graph.base_ids.tolist()
            ids = {graph.id_of(entity) for entity in base}
        except UnknownEntityError as error:
            raise ConfigError(f"`base`: {error}") from None
        self.base: tuple[int, ...] = tuple(sorted(ids))
        # Layer -1 stands for entities that no sequence of attempts can make.
        self.reachable = int((layers(graph, self.base) >= 0).sum())
        if self.reachable == len(self.base):
            labels = ", ".join(map(quoted, graph.labels(self.base))) or "(empty)"
            raise ConfigError(
                f"`base` {labels}: nothing new can be made from these entities in {graph.name}."
            )
        self.restart()

    def restart(self) -> None:
        """Forget everything except the base entities."""
        self.known: dict[int, None] = dict.fromkeys(self.base)
        self.tried: set[tuple[int, int]] = set()

    @property
    def is_complete(self) -> bool:
        """Whether all reachable entities are known."""
        return len(self.known) == self.reachable

    def combine(self, first: int, second: int) -> tuple[tuple[int, ...], bool]:
        """Combine two known entities.

        Returns:
            Ids of results that were unknown, and whether the pair was tried before.
        """
        # The order of ingredients has no meaning; pairs are kept in ascending order.
        pair = (first, second) if first <= second else (second, first)
        repeated = pair in self.tried
        self.tried.add(pair)
        # A pair may have several results, and all of them become known.
        new = tuple(result for result in self._outcomes.get(pair, ()) if result not in self.known)
        self.known.update(dict.fromkeys(new))
        return new, repeated
