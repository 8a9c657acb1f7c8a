"""Evaluation of scorers (models that rate triples or recipes), of agents, and of scripted players.

Read :mod:`~wordcraft_kg.evaluation.links` first: it has all habits of this room. Results are
views: a view is a frozen :class:`~wordcraft_kg.base.records.Record` with all numbers from an
evaluation. ``--json`` prints the view, and reports and the explorer show the same numbers. The JSON
Schema of ``report.json`` is derived from the view's type and checked when the file is written::

    view = view_links(rank_links(scorer, opened), name="mine")
    view.metrics["all"].mrr

- Links: ``ranked_links`` ranks and compares models, ``links`` makes the view,
  which has the slices and the calibration.
- Single scores: ``scores`` parses queries, and answers for triples and recipes; ``suggestions`` and
  ``likely_recipes`` propose recipes that a book lacks.
- Play: ``agents`` and ``agent_metrics`` for trained agents and scripted players, ``discovery`` for
  open-ended play.
- ``books``: views of recipe books and their tasks.

Helpers may change at will. A view's fields are read by programs: add fields with defaults, and keep
the names.
"""
