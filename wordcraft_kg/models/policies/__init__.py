"""Policies choose table slots: from states of B episodes to slot logits and state values.

Read ``states`` (the input), then ``policy`` (the base class) and the kinds: ``pairs``, which scores
pairs of slots, and ``networks``, which score single slots: the paper's self-attention actor-critic,
its baseline, and networks of one's own.
``policy_config`` holds the settings, ``sources`` the knowledge that may be mixed in;
``policy_folder`` makes, writes and loads policies::

    policy = load_policy("runs/guided")
    logits, value, sources, lambdas = policy(States(goal, selection, table))

Free to change: how a network computes its outputs, as long as the tests against slow references
pass. Not free: names of parameters and buffers, which are the tensors' names in existing run
folders; and the order of operations in ``networks`` and ``pairs``, since another rounding changes
all trained results (then raise ``VERSIONS`` in ``studies/plan.py``).
"""
