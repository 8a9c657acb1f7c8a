"""Elicitation: recipes named by a language model, which answers through an OpenAI-compatible endpoint (web address).

``requests`` sends the unanswered ``prompts`` to an ``endpoint``, ``answers`` stores the answers, ``reading`` parses
recipes, and ``folder`` writes a model folder with an ``ElicitedScorer``. Prompts contain entity labels, without recipes
or split information.
"""
