"""Opinions of a language model: which pairs of things make which thing, asked of any endpoint that speaks as OpenAI's.

``prompts`` is what is asked, ``endpoint`` who asks it, ``answers`` where answers are kept, ``asking`` asks what is not
there yet, ``reading`` makes opinions of answers, and ``folder`` writes them as a model folder, whose scorer is an
:class:`~wordcraft_kg.apps.elicitation.scorer.OpinionScorer`. Of the graph, prompts hold nothing but the labels of its
entities: no recipe, and nothing of the split.
"""
