"""Elicitation: knowledge from language models and sentence encoders, as tables and vectors."""
