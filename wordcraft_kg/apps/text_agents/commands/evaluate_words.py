"""Keeps an installation with the earlier entry point working; goes with the next installation."""

from wordcraft_kg.apps.text_agents.commands.evaluate_text import evaluate_text as evaluate_words  # noqa: F401
