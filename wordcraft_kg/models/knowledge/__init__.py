"""Knowledge from outside the recipe book, as tables over pairs of entities and as triples.

Read ``folder`` first: a knowledge folder holds tables from a language model or from a general graph
such as WordNet. The other files make a folder of a general graph, in the order of ``importing``:
``readers`` and ``wordnet`` read it into a ``network``, ``alignment`` finds the node of each label,
``paths`` makes tables, and ``surroundings`` takes triples and facts. Recipe scorers use tables,
link predictors triples.

A new kind of graph is a reader in ``importing``'s ``READERS``. Constants may change freely, with
new measurements in docs/outside-knowledge.md; what must stay is that no file here reads validation
or test recipes.
"""
