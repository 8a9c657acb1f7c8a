"""Scorers rate how plausible triples (head, relation, tail) are, learned or not.

Read ``protocol`` first (the interface), then ``scorer`` (the base class: labels to ids). The kinds
are ``factors`` (score tables, and ComplEx embeddings), ``baselines`` (facts, counts, neighbours and
votes, nothing learned), ``kernel`` (closed form) and ``recipes`` (scores for whole recipes). The
features of recipes come from the neighbour lists of the room ``neighbours``; a ``ranker`` makes
scores of them, and ``probabilities`` turns scores into probabilities. ``cross_fitting`` joins
models of all folds, ``scorer_folder`` loads and writes trained scorers, ``scales`` maps scores to a
common scale, ``ranking`` evaluates test triples, ``link_evidence`` explains scores by similar
entities and links, ``features`` provides entity vectors, and ``near_synonyms`` finds test recipes
that reword a train recipe. ``score_limits`` holds limits and settings, without torch.

A new scorer is a subclass of ``Scorer`` with ``_score``; it needs no line elsewhere. Change
anything inside a file freely, but not the formats that ``scorer_folder`` and the records write (old
folders must open), nor the rule of ``cross_fitting`` that assigns models to tasks (it keeps test
recipes out of training)::

    scorer = load_scorer("models/mine")
    scorer.score("water", "combinesWith", ["earth", "fire"])
    scorer.top(None, "componentOf", "mud")
"""
