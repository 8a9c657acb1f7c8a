"""Train link predictors (models that score triples) with PyKEEN, into model folders that open as scorers.

Read ``config`` first (all settings), then ``training``, ``fitting`` (epochs, validation, checkpoints), ``builders``
(from settings to a PyKEEN model, and from the model to scorer tensors) and ``records``. ``complex`` and
``symmetric_lcwa`` are model and objective of the WordCraft paper (Jiang et al. 2020), ``pykeen_bridge`` guards PyKEEN's
global generators, ``regularisation`` chooses weights on small and on large books, and ``popularity`` adds the log
counts of entities to the embeddings::

    trained = train_links(LinksConfig("everyday", ComplExConfig(epochs=20)), Path("models/mine"))
    model = open_model(trained.folder)
    rank_triples(model.scorer, model.opened.split.held_out("test"), model.opened.graph.triples)
"""
