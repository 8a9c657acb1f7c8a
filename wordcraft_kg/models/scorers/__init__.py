"""Scorers say how plausible a triple is: from a trained model, facts, counts, neighbours or kernels.

Read ``protocol`` first (the interface of all scorers), then ``scorer`` (their common handling of ids and labels), then
the kinds: ``tables`` (computed once, then looked up), ``embeddings`` and ``factors`` (computed on demand), ``facts``,
``votes``, ``neighbours`` and ``kernel_scorer`` (nothing learned), ``opinions`` (recipes with weights, from elsewhere
than the graph). ``recipe_kernel`` scores whole recipes; both kernels rest on ``similarity``, and on
``similarity_rows`` where there are too many pairs of entities. ``folder`` loads a trained scorer, ``queries`` are what
somebody asks it. ``scales`` brings scores of different origin to one scale, ``ranking`` evaluates a scorer on held-out
triples, ``features`` gives each entity a vector, ``near_synonyms`` finds test recipes that repeat a train recipe in
other words::

    scorer = load_scorer("models/mine")
    scorer.score("water", "combinesWith", ["earth", "fire"])
    scorer.top(None, "componentOf", "mud")
"""
