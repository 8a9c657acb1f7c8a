"""Scorers rate how plausible triples (head, relation, tail) are: models, facts, counts, neighbours or kernels.

Read ``protocol`` first (the interface), then ``scorer`` (the base class: labels to ids) and the kinds: ``factors``
(score tables, and ComplEx embeddings), ``baselines``, ``kernel`` (closed form), ``recipes`` (scores for whole recipes).
``folder`` loads and writes trained scorers, ``queries`` parses queries, ``scales`` maps scores to a common scale,
``calibration`` to probabilities, ``ranking`` evaluates test triples, ``features`` provides entity vectors,
``near_synonyms`` finds test recipes that reword a train recipe::

    scorer = load_scorer("models/mine")
    scorer.score("water", "combinesWith", ["earth", "fire"])
    scorer.top(None, "componentOf", "mud")
"""
