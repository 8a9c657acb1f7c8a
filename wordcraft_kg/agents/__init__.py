"""Agents: training by IMPALA with V-trace, scripted players, evaluation, explanation and open-ended discovery.

Start with ``impala`` (the trainer), ``vtrace`` and ``evaluation``. Values that depend only on parameters are computed
once per update (``Policy.weights``) for actor and learner. With policy lag k, the actor uses the values from k updates
ago, without a second network. A cross-fitted scorer has a model for each fold of the train recipes; on train tasks, the
task index selects the model (``states``).
"""
