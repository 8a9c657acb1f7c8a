"""Recipes as sets of one to eight ingredients: which sets make a goal, also one never seen?

Read ``scorer`` first: what a model answers. ``parts`` reads what entities consist of, ``knowledge``
holds the train recipes with all that is learned from them, ``loops`` are its compiled loops, and
``networks`` its small networks. Trainings are in :mod:`wordcraft_kg.models.recipes.set_training`.

**Parts** make new entities comparable, and give a rule, *coverage*: each part of the goal comes
from an ingredient, and an ingredient brings no part that the goal lacks. Train recipes tell the
exceptions: parts that recipes *lose* (of all train recipes that bring the part, the share whose
goal lacks it), and *shared* parts, which several ingredients of one set bring. All others are
*key* parts. With n train recipes and similarity ``w`` of the goal to each known goal::

    w(g, h) = exp(-(1 - Jaccard(parts)) / t - L1(amounts) / (2 l) - (1 - cosine(words)) / t)
    share(i | part, g) = sum of w(g, h) over train recipes of h with i, among ingredients with part

Three widths (t, l) and a network ``softmax(MLP(amounts, parts, words))`` give four shares. A beam
fills one key part after the other; an ingredient with several covers them all. In a second round a
part may come from one ingredient more, as often as train recipes do that; so may a lost part that
the goal has, from an ingredient without key parts, such as carbon for a carbide. The sets of the
nearest goals join, and a committee of small networks orders the candidates by features of each
set: sums and minima of log shares, votes for the whole set, how often its ingredients occur
together, its size, how far the kinds of its ingredients are from those of similar recipes, whether
amounts of the ingredients can add up to the goal's (least squares, none below 0), and the share of
similar recipes that agree with it, ``sum of w(g, h) .1 ** (number of a recipe's allowed ingredients
that the set lacks)``. The committee learns from folds of train goals, each scored by knowledge
without its recipes. Without parts, a single part that everything has takes their place, and the
beam adds ingredients until the set has the sizes of the neighbours' sets.

**Probabilities** are a softmax over the candidates and *none of them*, with a temperature and a
bias fitted on goals that a network of the committee has not seen. ``rules`` imports a user's own
rule, which leaves sets out and changes no probability.
"""
