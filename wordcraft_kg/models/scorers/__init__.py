"""Scorers rate the plausibility of triples: trained models, facts, counts, neighbours or kernels.

Read ``protocol`` first (the interface), then ``scorer`` (the base class: ids and labels) and the kinds: ``factors``
(tables, and scores on demand), ``baselines``, ``kernel`` and ``low_rank_kernel`` (closed form), ``recipes`` (whole
recipes). ``folder`` loads and writes trained scorers, ``queries`` parses queries, ``scales`` maps scores to a common
scale, ``calibration`` to probabilities, ``ranking`` evaluates test triples, ``features`` provides entity vectors,
``near_synonyms`` finds reworded train recipes::

    scorer = load_scorer("models/mine")
    scorer.score("water", "combinesWith", ["earth", "fire"])
    scorer.top(None, "componentOf", "mud")
"""
