"""Knowledge from outside the recipe book: word vectors, other books, and tables of any source.

Read ``outside`` first: it opens the sources of a training as features of links. ``books`` holds
word vectors, and other books without the recipes that both share, and ``knowledge_folder`` reads
and writes a knowledge folder: tables from a language model or from a general graph such as
WordNet. The other files make such a folder of a general graph, in the order of ``importing``:
``readers`` read it into a ``network``, which also finds the node of each label, and
``surroundings`` makes tables and triples. Recipe scorers use all sources, link predictors
the triples of folders. The page docs/outside-knowledge.md describes them to users.

A new kind of graph is a reader in ``importing``'s ``READERS``. Constants may change freely, with
new measurements in docs/outside-knowledge.md; what must stay is that no file here learns from
validation or test recipes: they are only compared, so that they can be left out.
"""
