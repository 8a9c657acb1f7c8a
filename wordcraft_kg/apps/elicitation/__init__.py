"""Elicitation: knowledge from language models and sentence encoders, as tables and vectors.

Read ``language_model`` first: it writes a knowledge folder, from the texts of ``prompts.json``.
``encoder`` makes entity vectors. ``foreign_code`` finds, hashes and loads the model files of both,
and refuses a model that would run code, or ask for far more memory than
its weights hold, before any library reads it.

Prompts may be added freely, in a file of the user's own. The default prompts were chosen on
validation recipes, and results in the guides depend on them. ``_BATCH`` in ``language_model`` is
part of the result's last bits. Every rule in ``foreign_code`` closes a known way to run code from
a model folder: add rules, but remove none without a review.
"""
