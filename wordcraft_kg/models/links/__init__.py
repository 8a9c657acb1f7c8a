"""Training link predictors, by PyKEEN, into model folders that serve as scorers.

Read ``config`` first (every setting), then ``training``, ``epochs`` (what happens after each: validation, trace,
checkpoint), ``results`` and ``builders`` (how each kind becomes a PyKEEN model, and which parts of it the scorer
keeps). ``complex`` and ``symmetric_lcwa`` are the paper's model and objective, ``pykeen_bridge`` guards PyKEEN's global
generators, ``regularisation`` chooses weights on small and on large books, ``popularity`` puts one of them into the
embeddings,
``tuning`` searches settings, ``folder`` opens a finished model with everything that its evaluation needs, and
``records`` describes its files::

    trained = train_links(LinksConfig("everyday", ComplExConfig(epochs=20)), Path("models/mine"))
    model = open_model(trained.folder)
    rank_triples(model.scorer, model.opened.split.held_out("test"), model.opened.graph.triples)
"""
