"""Agents: training by IMPALA with V-trace, scripted players, evaluation, explanation and discovery.

Read ``impala`` (the trainer) first, and ``losses`` (V-trace among them); ``agent_training``
makes a run of it, with ``agent_records`` and ``agent_folder`` for the files. ``agent_config`` holds
the settings, ``states`` turns environment states into tensors. ``evaluation`` plays policies and
``players`` scripted players; ``explanation`` explains actions; ``discovery`` and
``recipe_discovery`` play the open-ended game; ``sb3`` trains our policies by Stable-Baselines3.

Values that depend only on parameters are computed once per update (``Policy.weights``) for actor
and learner. With policy lag k, the actor uses the values from k updates ago, without a second
network. A cross-fitted scorer has a model for each fold of the train recipes; on train tasks, the
task index selects the model (``states``).

Free to change: how an update computes its loss, as long as the tests against a slow reference pass
and published results are made again (``VERSIONS`` in ``studies/plan.py``). Not free: field names in
``agent_records``, which are those in existing run folders, and names of the metrics.
"""
