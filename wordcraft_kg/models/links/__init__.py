"""Training link predictors, by PyKEEN, into model folders that serve as scorers.

Read ``config`` first (every setting), then ``training``, ``fitting`` (what happens in and after each epoch),
``builders`` (how each kind becomes a PyKEEN model, and which parts of it the scorer keeps) and ``records``. ``complex``
and ``symmetric_lcwa`` are the paper's model and objective, ``pykeen_bridge`` guards PyKEEN's global generators,
``regularisation`` chooses weights on small and on large books, ``popularity`` puts one of them into the embeddings,
``tuning`` searches settings::

    trained = train_links(LinksConfig("everyday", ComplExConfig(epochs=20)), Path("models/mine"))
    model = open_model(trained.folder)
    rank_triples(model.scorer, model.opened.split.held_out("test"), model.opened.graph.triples)
"""
