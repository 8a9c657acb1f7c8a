"""Recipes elicited from a language model at an OpenAI-compatible endpoint.

``asking`` sends the unanswered ``prompts`` to an ``endpoint``, ``answers`` stores the answers, ``reading`` parses
opinions, and ``folder`` writes a model folder with an ``OpinionScorer``. Prompts contain entity labels, without recipes
or information on the split.
"""
