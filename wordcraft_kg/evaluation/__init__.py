"""What reports, ``--json`` and pages show: typed values, built once; text and pictures are made from them.

A view is a frozen :class:`~wordcraft_kg.base.records.Record`, ready for JSON with
:func:`~wordcraft_kg.base.records.as_values`. Where a value of a lower package already has all that is shown (an audit,
a summary of people's sessions), that value is the view and this package has none.

::

    view = view_links(judge_links(scorer, opened), name="mine")
    view.metrics["all"].mrr
"""
