"""A recipe graph as a PyKEEN dataset, found through the entry point group ``pykeen.datasets``.

PyKEEN loads this module in the middle of its own imports, whichever of its modules came first. So
it imports no more of PyKEEN than the base class.
"""

from pathlib import Path
from typing import Any

from pykeen.datasets import dataset_resolver
from pykeen.datasets.base import EagerDataset

from wordcraft_kg.base.errors import SplitError
from wordcraft_kg.graphs.graph_folder import open_graph


class WordCraft(EagerDataset):
    """The PyKEEN dataset ``wordcraft``: trains on the partial graph, tests on held-out triples.

    Validation and test triples are those that the training triples do not contain, so PyKEEN's
    metrics are free of leaks.
    """

    def __init__(
        self, graph: str | Path = "everyday", create_inverse_triples: bool = False, **kwargs: Any
    ) -> None:
        """Open a graph.

        Args:
            graph: a graph folder, a recipe book's file, or the name of a known book (split by
                recipe, seed 0).
            create_inverse_triples: as in PyKEEN.
            kwargs: passed to PyKEEN's dataset class.

        Raises:
            SplitError: if the graph's split has no test triples.
        """
        from wordcraft_kg.models.links.pykeen_bridge import triples_factory

        opened = open_graph(graph)
        test = opened.split.held_out("test")
        valid = opened.split.held_out("valid")
        if not len(test):
            raise SplitError(
                f"'{graph}' has no unseen test triples; build it with another split, such as "
                "by-recipe."
            )
        super().__init__(
            training=triples_factory(
                opened.graph, opened.split.partial, create_inverse_triples=create_inverse_triples
            ),
            testing=triples_factory(opened.graph, test),
            validation=triples_factory(opened.graph, valid) if len(valid) else None,
            **kwargs,
        )

    def to_directory_binary(self, path: str | Path) -> None:
        """Write as PyKEEN does, but not into PyKEEN's own cache.

        That cache goes by arguments: a graph that was built again in the same folder, or a folder
        of the same name elsewhere, would get the triples of the first.
        """
        from pykeen.datasets.utils import PYKEEN_DATASETS as CACHE

        if not Path(path).resolve().is_relative_to(CACHE.resolve()):
            super().to_directory_binary(path)


# For when this module is imported before PyKEEN's: the entry point then finds it only half
# imported.
dataset_resolver.register(WordCraft, raise_on_conflict=False)
