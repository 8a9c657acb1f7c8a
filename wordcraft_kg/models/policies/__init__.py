"""Policies: from the ids of goal, selection and table to logits of the slots and a value.

Read ``config`` first (every setting), then ``policy`` (shared by all policies) and the two kinds, ``attention``
(over the table, alone or guided by knowledge) and ``mlp``; ``folder`` makes, writes and loads policies::

    policy = load_policy("runs/guided")
    logits, value, sources, lambdas = policy(goal, selection, table)
"""
