"""Evaluation of scorers (models that rate triples or recipes), of agents, and of scripted players.

Results are views: a view is a frozen :class:`~wordcraft_kg.base.records.Record` with all numbers from an evaluation.
``--json`` prints the view, and reports and the explorer show the same numbers. The JSON Schema of ``report.json`` is
derived from the view's type and checked when the file is written::

    view = view_links(rank_links(scorer, opened), name="mine")
    view.metrics["all"].mrr
"""
