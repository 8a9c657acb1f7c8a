"""Term definitions for reports and pages, shown in tooltips and ``docs/terms.md``."""

from typing import Literal

from wordcraft_kg.base.records import Record
from wordcraft_kg.models.policies.sources import ALPHA, BUILT_IN, Label, label_of

Topic = Literal["Graphs", "Links", "Play", "Agents"]


class Term(Record):
    """A glossary term: topic, name, definition in one to three sentences, and symbol in formulas."""

    topic: Topic
    name: str
    meaning: str
    symbol: str = ""


def _term(label: Label) -> Term:
    return Term("Agents", label.words, label.meaning or label.about, label.symbol)


_TERMS: dict[Topic, dict[str, tuple[str, ...]]] = {
    "Graphs": {
        "combines_with": (
            "combinesWith",
            "The relation between the two ingredients of a recipe. It is symmetric: each recipe gives one triple in "
            "each direction.",
        ),
        "component_of": ("componentOf", "The relation from an ingredient of a recipe to its result."),
        "layer": (
            "crafting rounds",
            "The number of rounds before an entity can be made, if each round combines all known pairs.",
        ),
        "full": (
            "full graph",
            "The triples of all recipes. A model trained on the full graph has seen the test recipes, so its metrics "
            "measure memory.",
        ),
        "partial": (
            "partial graph",
            "The triples of the train recipes. Train on this graph if the metrics should measure prediction.",
        ),
        "unseen": (
            "unseen triple",
            "A triple of a test recipe that no train recipe gives. Only unseen triples are evaluated.",
        ),
        "leaked": (
            "leaked triple",
            "A triple of a test recipe that a train recipe gives as well. A model can answer it from its training "
            "data, so it is left out.",
        ),
        "mirrored": (
            "mirrored triple",
            "A combinesWith triple in the other direction. A mirrored test triple in the training data would give the "
            "answer away.",
        ),
        "self_edge": (
            "self edge",
            "The score of an entity with itself. Models tend to rank self edges first for combinesWith, although few "
            "entities combine with themselves. Self edges can be kept, kept only where training has them (observed), "
            "or dropped.",
        ),
        "one_away": (
            "one ingredient away",
            "A test recipe that shares an ingredient and the result with a train recipe; only the other ingredient is "
            "new. Most test recipes of a by-recipe split are one ingredient away; by-slot and by-goal splits have "
            "none.",
        ),
        "near_synonym": (
            "near-synonym",
            "An ingredient with nearly the same word vector as the ingredient that it replaces in a train recipe with "
            "the same result. Such a test recipe is closer to a paraphrase than to a prediction.",
        ),
    },
    "Links": {
        "in_sample": (
            "in-sample",
            "Scores that a model gives to its own training recipes. An agent that learns from in-sample scores trusts "
            "the scorer too much.",
        ),
        "cross_fitted": (
            "cross-fitted",
            "Each train recipe is scored by a model trained without that recipe: the train recipes are cut into "
            "folds, and each fold has a model trained on all other folds. Cross-fitted scores are out-of-sample "
            "scores.",
        ),
        "query": ("query", "A triple without its head or its tail. The model ranks all entities for the open slot."),
        "filtered": ("filtered", "Ranks that ignore other true answers. Raw ranks count them as competitors."),
        "realistic": (
            "realistic ties",
            "Entities with equal scores share their mean rank, so a model with constant scores gets the rank of "
            "chance. Optimistic ties rank the true entity first, pessimistic ties last.",
        ),
        "mrr": ("MRR", "Mean reciprocal rank: the mean of 1 / rank of the true entity over all queries. 1 is perfect."),
        "hits": ("hits@k", "The share of queries with the true entity among the first k."),
        "amri": (
            "AMRI",
            "Adjusted mean rank index: 1 is perfect, 0 is the mean rank of chance, and negative values are worse than "
            "chance.",
        ),
        "interval": (
            "95 % CI",
            "Confidence interval: a range that covers the true value in about 95 of 100 repetitions of the "
            "experiment. Link metrics use a bootstrap over recipes, because the triples of a recipe belong together.",
        ),
        "paired": (
            "paired difference",
            "Two models or agents answer the same queries or tasks, which are resampled in pairs. If the interval of "
            "the difference contains 0, the result is level.",
        ),
        "ece": (
            "ECE",
            "Expected calibration error: the mean difference between the confidence of the best candidate and its "
            "accuracy.",
        ),
        "calibrated": (
            "probability of a triple",
            "The chance that a recipe of the book gives a triple outside the training data. Among triples with a "
            "calibrated probability of 10 %, about a tenth are true.",
        ),
        "support": (
            "supporting evidence",
            "Training links with the same head or tail that the model scores in nearly the same way. The weight is "
            "the cube of the cosine of the two rows of scores; the share is relative to the sum of all weights.",
        ),
        "base_rate": (
            "base rate",
            "The share of true triples among all triples outside the training data: the best probability without "
            "scores.",
        ),
        "log_loss": ("log loss", "The mean of -log(probability of the observed outcome), in nats. Lower is better."),
        "frequency": (
            "frequency rule",
            "Baseline without training: rank entities by their frequency in the training triples.",
        ),
        "votes": (
            "vote count",
            "Baseline without training: count how often each ingredient occurs in train recipes with this result. "
            "Votes use identities and no words. Triple scores sum over the missing part of the recipe.",
        ),
        "neighbours": (
            "neighbour rule",
            "Baseline without training: follow the links of entities with the same neighbours in the training graph.",
        ),
        "random": ("random order", "Baseline: the expected metric of a random ranking, computed exactly."),
    },
    "Play": {
        "goal": ("goal", "The entity to make in a task."),
        "distractor": ("distractor", "An entity on the table that the task does not need."),
        "distractor_seeds": (
            "distractor seeds",
            "The number of different tables for each task. Each seed samples other distractors; every player gets the "
            "same tables.",
        ),
        "depth": ("depth", "The number of recipes in the shortest plan of a task."),
        "plan": ("plan", "Recipes that make the goal from the starting ingredients of the task."),
        "by_plan": (
            "by its own recipe",
            "The last pair belongs to one of the task's plans (at depth 1: the task's recipe). Otherwise another pair "
            "on the table made the goal, for example a train recipe.",
        ),
        "reference_pack": (
            "reference pack",
            "Figures shipped with the package: chance, graphs, oracles and agents on the same tasks, and published "
            "figures for people and language models on other tasks.",
        ),
        "greedy": ("greedy", "The agent always takes its best slot instead of sampling."),
        "oracle": ("recipe oracle", "A player that looks up all recipes; the upper bound of success."),
    },
    "Agents": {
        "evidence": (
            "evidence",
            "Known recipes that support a recipe score. Each has a similarity (both ingredients and the result; 1 is "
            "identical) and a share of the total evidence.",
        ),
        "lambda": ("mixing weight", "The learned weight of a source: λα, λu, λv, λw.", "λ"),
        "beta": (
            "logit",
            "The sum of a slot's scores, each multiplied by its mixing weight: λα·α + λu·u + λv·v + λw·w.",
            "β",
        ),
        "pi": ("probability", "The chance of choosing a slot during training: the softmax of the logits.", "π"),
        "value": ("state value", "The return that the agent expects from this state.", "V"),
        "return": ("return", "The sum of the rewards of an episode."),
        "entropy": (
            "entropy",
            "The uncertainty of the policy, in nats: 0 for a deterministic policy, highest for equally likely slots.",
        ),
        "grad_norm": ("gradient norm", "The length of the gradient of the loss before clipping."),
        "over_seeds": (
            "over seeds",
            "Student's t interval of the mean over seeds: the variation between trainings. None for one seed, and wide "
            "for two.",
        ),
        "over_tasks": (
            "over tasks",
            "An interval by resampling tasks, with all distractor seeds of a task together: the variation between "
            "tasks, for one trained agent.",
        ),
    },
}
GLOSSARY = {
    **{label.name: _term(label) for label in (ALPHA, *BUILT_IN.values())},
    **{key: Term(topic, *term) for topic, terms in _TERMS.items() for key, term in terms.items()},
}


def find_term(key: str) -> Term:
    """Return the term for a key, a glossary entry or a registered score source; KeyError if the key is unknown."""
    return GLOSSARY[key] if key in GLOSSARY else _term(label_of(key))
