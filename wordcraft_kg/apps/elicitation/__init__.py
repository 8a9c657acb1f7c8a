"""Elicitation: knowledge from language models and sentence encoders, as tables and vectors.

``language_model`` first: it writes a knowledge folder. ``encoder`` makes entity vectors, and
``weights`` finds, hashes and checks the model files of both.
"""
