"""Serving pages on the own machine: the guard before every server, and its start."""
