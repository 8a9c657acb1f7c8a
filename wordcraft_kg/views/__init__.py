"""What reports, ``--json`` and pages show: values of known types, built once, from which text and pictures are made.

A view is a frozen :class:`~wordcraft_kg.records.Record`, ready for JSON with
:func:`~wordcraft_kg.records.as_values`. Where the value of a lower room says all that is shown (an audit, a comparison
of links, a summary of people's sessions), that is the view and this package has none.

::

    view = view_links(judge_links(scorer, opened), name="mine")
    view.metrics["all"].mrr
"""
