"""Recipe scorers: how plausible is a result of two ingredients?

Read ``fitting`` first: how rankers learn from held-out recipes, and how the fits without each fold
share their work; ``committee`` fits the networks. ``encoder_fitting`` fits pair encoders, for large
books. ``recipe_training`` makes a model folder of the fits, also of scorers that learn from outside
knowledge alone, and ``outside_evidence`` names what outside knowledge says for a recipe; its
sources are in :mod:`wordcraft_kg.models.knowledge`. ``inductive`` scores entities that the graph
lacks. The features and their mathematics are in :mod:`wordcraft_kg.models.scorers.neighbours`.

**The pair encoder** scores any result of a pair, where neighbour lists need known recipes with
similar entities in all three places. With n recipes, E entities, word vectors of length D, and
lengths U, V and Z of ingredients, hidden units and results::

    h(x) = relu(W1 v_x + id_x),  z = MLP[h_a + h_b, h_a h_b, |h_a - h_b|],  g_c = W2 v_c + id'_c
    s = z · g_c + bias_c + u(a, b)
    loss = -log softmax_c(z · g_c + bias_c - log q_c) - log softmax_ab(z_ab · g_c + u_ab)

The first softmax is over results of the batch and sampled ones, the second over pairs of the batch
and corrupted ones; q is the expected number of draws. The scores s, s - u and u are features of the
recipe ranker, which learns from an encoder that has not seen the held-out fold; and the encoder
proposes results of a pair, which a ranker of their own scores, see
:mod:`wordcraft_kg.models.scorers.neighbours.results`. Intermediates of a plan come from neighbour
lists alone: with half of them proposed by the encoder, the planner solves no more (.388 in place of
.399 of 338 validation tasks of depth 2) and takes 2.7 times as long.

| step | cost |
|---|---|
| a step of the fit, B recipes, N sampled | 2 B V (3 U + Z) + (B + N) D Z + B (3 B + N) Z |
| an encoder | n / B steps an epoch; five folds need six encoders |
| features of a table with A slots | A² V (3 U + Z) / 2, each pair once in a batch |
| proposals for a pair | V (3 U + Z) + E Z |
| memory of an encoder | E (U + Z + 1) + 3 U V + V Z + D (U + Z), entities in half precision |

On Infinite Craft an encoder takes about 100 CPU seconds, one of everyday's size 3. On a validation
part of Infinite Craft (a tenth of train; success with 8 distractors): by recipe .623 without, .650
with batches of 1,024, .659 with 512; 4 epochs in place of 7 cost .007 by recipe and .005 by goal.
Twice the step size, 4e-3, leaves it at .658 and raises the true result's MRR by the encoder alone
from .340 to .349; 10 epochs with fewer dropped vectors are no better.

On 3,000 test tasks with 8 and 1 distractors, w solves .642 and .878 by recipe, .570 and .852 by
goal (without encoder .603 and .848, .556 and .830). The true result of 2,000 test pairs has an MRR
of .491 among all 31,645 entities, and is among the first 32 of .799, at 3.3 CPU ms a pair.

Change anything freely but what keeps held-out recipes out of features: a test replaces each
held-out result and compares all bytes.
"""
