"""Learning and acting: IMPALA with V-trace, scripted players, evaluation, explanation and open-ended discovery.

Read ``impala`` (the trainer), ``vtrace`` and ``evaluation`` first. Values that depend on the parameters alone are
computed once per update (``Policy.weights``) and shared by the actor and the learner; with a policy lag of k the actor
uses those of k updates ago, so no second network is kept. All parameters are views of one flat tensor, so an optimiser
step takes few calls. Code that asks about train tasks passes the number of the task, which decides which cross-fitted
model answers (``states``).
"""
