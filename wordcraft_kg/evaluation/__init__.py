"""Scorers, agents and players evaluated as typed values, each computed once.

A view is a frozen :class:`~wordcraft_kg.base.records.Record`. ``--json`` prints it, reports and the explorer render it,
and the JSON Schema of ``report.json`` is derived from its type and checked when the file is written::

    view = view_links(rank_links(scorer, opened), name="mine")
    view.metrics["all"].mrr
"""
