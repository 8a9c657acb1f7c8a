"""Kinds of splits: functions ``(graph, config, rng) -> Draw`` that :data:`~wordcraft_kg.graphs.splits.SPLITS` names."""
