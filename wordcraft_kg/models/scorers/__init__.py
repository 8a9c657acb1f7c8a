"""Scorers say how plausible a triple is: from a trained model, facts, counts, neighbours or kernels.

Read ``protocol`` first (the interface of all scorers), then ``scorer`` (their common handling of ids and labels), then
the kinds: ``tables`` (computed once, then looked up), ``factors`` (computed on demand), ``baselines`` (counts,
neighbours, votes), ``kernel`` and ``low_rank_kernel`` (closed form), ``recipes`` (whole recipes). ``folder`` loads a
trained scorer, ``queries`` parses user queries. ``scales`` brings scores of different origin to one scale,
``calibration`` turns them into probabilities, ``ranking`` evaluates a scorer on held-out triples, ``features`` gives
each entity a vector, ``near_synonyms`` finds test recipes that repeat a train recipe in other words::

    scorer = load_scorer("models/mine")
    scorer.score("water", "combinesWith", ["earth", "fire"])
    scorer.top(None, "componentOf", "mud")
"""
