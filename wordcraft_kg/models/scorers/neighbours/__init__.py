"""Recipe knowledge by neighbour lists: time and memory grow with entities and recipes.

With E entities, n recipes and word vectors of length D. Read :mod:`.knowledge` first.

**Similarity.** An entity's profile is its sparse row of partners, results, ingredients and
contexts (:func:`~wordcraft_kg.models.scorers.kernel.profiles`), with length 1; w is the cosine of
word vectors::

    k(x, y) = [cos(profiles) + .2 max(0, w)²] / √(norm_x norm_y)
    norm = 1.2 with recipes, .2 without

Only the K entities with the most similar profiles are kept for each entity (and the entity for
each of them), and the K_w nearest by words; k is computed when it is needed: a look-up and one
product of word vectors. The lists N(x) and G(c) hold the entities with the largest k among both
kinds of neighbours: N(x) those that are ingredients of known recipes, G(c) those that known recipes
make.

**Features** of a pair (a, b) and a goal c, with squared similarities k²::

    pair side   Σ k²(a, a') k²(b, b') k²(c, c')
                over a' in N(a), b' in N(b) with a known recipe a' + b' -> c'
    link side   Σ k²(x, x') k²(c, c') n(x', c')
                over x' in N(x), c' in G(c); n counts recipes

and the same by words (w⁴ for k²), without c; known recipes; kernel regression; the words that
regression expects of a result; cosines; degrees. A product below .002 ends a search in both lists.
A hash table answers whether a pair has recipes. A book of at most 2,048 entities has all k and word
cosines in matrices: most of the time of a table went to products of word vectors. All slots of a
table share its goal, so the links to the goal's neighbours are listed once, by their ingredient.

**Links** are scored by networks (rankers) of such features: for componentOf(x, c) those of the link
side, for combinesWith(a, b) known pairs of one end and a neighbour of the other; both with kernel
regression at low rank m, see :mod:`.regression`. Each link is computed by itself, see
:mod:`.links`: features of tables, agents and link prediction share one loop. The score of
componentOf is a feature of pairs.

| step | cost |
|---|---|
| profiles | n |
| structural neighbours | Σ of length² of profile columns, those above 1,000 skipped |
| neighbours by words | E² D, exact, in blocks; once for all folds |
| lists N, G and supporting recipes | E (K + K_w) D |
| regression | E L D + L³ + n m, for L <= 1,536 landmarks |
| features of a table with A slots | A N G + A² (N² + m) + D per result, at most |
| a link | N G + m and the goal's ingredients, or N + m, at most |
| memory | E (4 K + 3 N + 3 G + 3 R + D + 3 m) + about 30 n numbers; 2 E² of a small book |

A model of a large book has a pair encoder besides (:mod:`.pair_encoder`), whose scores are three
further features; :mod:`.results` proposes results of a pair by both.

With lists as long as the book nothing is approximate but the pruning: tests compare features with
full tables.

Compiled loops check no bounds: :mod:`.storage` says what they rely on, and checks stored tensors
for it whenever knowledge is made.

The page docs/explanation/recipe-scorer.md explains the formulas and names the function of each.

Read :mod:`.knowledge` for scores, :mod:`.storage` for what is stored, :mod:`.pair_features` and
:mod:`.feature_loops` for the features of tables, :mod:`.links` for those of links, :mod:`.similar`
for k. Loops that make lists and hash tables are in :mod:`.list_loops` and :mod:`.hash_loops`; all
cores share them, see :mod:`.blocks`. Those that propose what a plan may make first are in
:mod:`.candidate_loops`. The loops are compiled by numba: lists end at different places, and
searches stop early, which vectorised operations would pad to the longest.
"""
