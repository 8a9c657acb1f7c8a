"""Policies: from the ids of goal, selection and table to logits of the slots and a value.

Read ``config`` first (every setting), then ``policy`` (what all policies share) and the two kinds, ``actor_critic``
(attention over the table, alone or guided by knowledge) and ``mlp``. ``attention`` holds the pieces of the former,
``mixing`` the formula that mixes knowledge with its logits; ``folder`` makes, writes and loads policies::

    policy = load_policy("runs/guided")
    logits, value, sources, lambdas = policy(goal, selection, table)
"""
