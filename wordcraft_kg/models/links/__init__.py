"""Train link predictors with PyKEEN into model folders that serve as scorers.

Read ``config`` first (all settings), then ``training``, ``fitting`` (epochs, validation, checkpoints), ``builders``
(from settings to a PyKEEN model, and from the model to scorer tensors) and ``records``. ``complex`` and
``symmetric_lcwa`` are the paper's model and objective, ``pykeen_bridge`` guards PyKEEN's global generators,
``regularisation`` chooses weights on small and on large books, ``popularity`` adds log counts to the embeddings, and
``tuning`` searches settings::

    trained = train_links(LinksConfig("everyday", ComplExConfig(epochs=20)), Path("models/mine"))
    model = open_model(trained.folder)
    rank_triples(model.scorer, model.opened.split.held_out("test"), model.opened.graph.triples)
"""
