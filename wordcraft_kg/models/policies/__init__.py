"""Policies choose table slots: from ids (goal, selection, table) to slot logits and a state value.

Read ``config`` (settings), then ``policy`` (the base class) and both kinds, ``attention`` and ``mlp``; ``folder``
makes, writes and loads policies::

    policy = load_policy("runs/guided")
    logits, value, sources, lambdas = policy(goal, selection, table)
"""
