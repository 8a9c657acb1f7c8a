"""Recipe scorers: how plausible is a result of two ingredients?

Read ``fitting`` first: how rankers learn from held-out recipes, and how the fits without each fold
share their work; ``committee`` fits the networks. ``training`` makes a model folder of the fits,
and ``memory`` says before the start what they take. ``outside`` reads knowledge from outside the
train recipes, ``zero_shot`` learns from it alone, ``outside_evidence`` names what speaks for a
recipe. ``inductive`` scores entities that the graph lacks. The features and their mathematics are
in :mod:`wordcraft_kg.models.scorers.neighbours`.

Change anything freely but what keeps held-out recipes out of features: a test replaces each
held-out result and compares all bytes.
"""
