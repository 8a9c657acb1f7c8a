"""Train link predictors (models that score triples) with PyKEEN, into model folders.

Read ``link_config`` first (all settings), then ``link_training`` (a run from begin to model folder,
with the models of folds), ``fitting`` (epochs, checkpoints, choice of weights), ``builders`` (from
settings to a PyKEEN model, and from the model to scorer tensors) and ``link_records`` (the folder's
files). ``complex_model`` and ``symmetric_lcwa`` are model and objective of the WordCraft paper
(Jiang et al. 2020). ``pykeen_bridge`` reads triples from outside the book, guards PyKEEN's global
generators, and makes scorers from models of PyKEEN's pipeline. PyKEEN is used in this package and
in ``wordcraft_kg/pykeen_dataset.py``, and nowhere else.

Add a kind of model freely: its settings in ``link_config``, branches in ``builders``. Changes
of sums, of their order or of random draws change the bits of trained models; such a change needs a
new number in ``VERSIONS`` (``studies/plan.py``)::

    trained = train_links(LinksConfig("everyday", ComplExConfig(epochs=20)), Path("models/mine"))
    model = open_model(trained.folder)
    rank_triples(model.scorer, model.opened.split.held_out("test"), model.opened.graph.triples)
"""
