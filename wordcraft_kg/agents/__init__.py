"""Learning and acting: IMPALA with V-trace, scripted players, evaluation, explanation and open-ended discovery.

Start with ``impala`` (the trainer), ``vtrace`` and ``evaluation``. Values that depend only on parameters are computed
once per update (``Policy.weights``) for actor and learner; with a policy lag of k the actor uses the values from k
updates ago, so no second network is kept. On train tasks, code passes the task index, which selects the cross-fitted
model (``states``).
"""
