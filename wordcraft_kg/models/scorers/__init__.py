"""Scorers rate the plausibility of triples (head, relation, tail): models, facts, counts, neighbours or kernels.

Read ``protocol`` first (the interface), then ``scorer`` (the base class, which converts labels to ids) and the kinds of
scorers: ``factors`` (score tables, and products of matrix factors), ``baselines``, ``kernel`` and ``low_rank_kernel``
(closed form), ``recipes`` (scores for whole recipes). ``folder`` loads and writes trained scorers, ``queries`` parses
queries, ``scales`` maps scores to a common scale, ``calibration`` maps scores to probabilities, ``ranking`` ranks the
answers of test triples, ``features`` provides entity vectors, ``near_synonyms`` finds test recipes that reword a train
recipe::

    scorer = load_scorer("models/mine")
    scorer.score("water", "combinesWith", ["earth", "fire"])
    scorer.top(None, "componentOf", "mud")
"""
