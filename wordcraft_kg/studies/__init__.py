"""Comparisons of agents as data: studies, what follows from them, the engine that does it, and what came out."""
