"""How plausible is a triple? Whatever answers that: a trained model, facts, counts, neighbours.

Read ``protocol`` first (what anybody may ask of a scorer), then ``scorer`` (ids and labels, shared by all), then the
kinds: ``tables`` (scored once, looked up), ``embeddings`` (scored when asked), ``facts`` and ``neighbours`` (nothing
learned). ``folder`` loads what a training has left. ``scales`` brings scores of different origin to one scale,
``ranking`` judges a scorer on held-out triples, ``features`` gives each entity a vector, ``near_synonyms`` finds test
recipes that repeat a train recipe in other words::

    scorer = load_scorer("models/mine")
    scorer.score("water", "combinesWith", ["earth", "fire"])
    scorer.top(None, "componentOf", "mud")
"""
