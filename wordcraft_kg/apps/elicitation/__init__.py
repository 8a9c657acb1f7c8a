"""Opinions of a language model: asked of an OpenAI-compatible endpoint which pairs of things make which thing.

``prompts`` are asked by ``endpoint``, ``answers`` keeps the answers, ``asking`` asks the missing ones, ``reading``
reads opinions from them, and ``folder`` writes a model folder with an ``OpinionScorer``. Prompts hold nothing of the
graph but the labels of its entities: no recipe, and nothing of the split.
"""
