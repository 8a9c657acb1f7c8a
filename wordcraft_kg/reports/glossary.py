"""The words of reports and pages, each explained once: tooltips and ``docs/glossary.md`` are made from it."""

from typing import Literal

from wordcraft_kg.base.records import Record
from wordcraft_kg.models.policies.sources import ALPHA, BUILT_IN, Label, label_of

Topic = Literal["Graphs", "Links", "Play", "Agents"]


class Term(Record):
    """A word, its meaning in a sentence or two, and the symbol that stands for it in formulas."""

    topic: Topic
    name: str
    meaning: str
    symbol: str = ""


def _term(label: Label) -> Term:
    return Term("Agents", label.words, label.meaning or label.about, label.symbol)


_TERMS: dict[Topic, dict[str, tuple[str, ...]]] = {
    "Graphs": {
        "recipe": (
            "recipe",
            "Two ingredients and what they make. Their order does not matter, and a pair may make several things.",
        ),
        "combines_with": (
            "combinesWith",
            "The relation of the two ingredients of a recipe. It is symmetric: each recipe gives it in both "
            "directions.",
        ),
        "component_of": ("componentOf", "The relation from an ingredient of a recipe to what the recipe makes."),
        "layer": (
            "crafting rounds",
            "How many rounds of crafting an entity is away from the base, if each round makes all that can be made.",
        ),
        "full": (
            "full graph",
            "The triples of all recipes. A model trained on it has seen the answers, so its figures measure memory.",
        ),
        "partial": ("partial graph", "The triples of the train recipes: what an honest model is trained on."),
        "unseen": ("unseen triple", "A triple of a test recipe that no train recipe gives. Only these are evaluated."),
        "leaked": (
            "leaked triple",
            "A triple of a test recipe that a train recipe gives too. A model can answer it from memory, so it is "
            "left out.",
        ),
        "mirrored": (
            "mirrored triple",
            "A combinesWith triple read the other way round. If the mirror of a test triple were in training, the "
            "test triple would be given away.",
        ),
        "self_edge": (
            "self edge",
            "The score of an entity with itself. Models tend to rank it first by combinesWith, although most "
            "entities do not combine with themselves. It can be kept, kept where training has it (observed), or "
            "dropped.",
        ),
        "one_away": (
            "one ingredient away",
            "Sharing an ingredient and the result with a train recipe, so that only the other ingredient is new. "
            "Most test recipes of a split by recipe are; none is if the split is by slot or by goal.",
        ),
        "near_synonym": (
            "near-synonym",
            "An ingredient that replaces another one of a train recipe with the same result and has nearly the same "
            "word vector. Such a test recipe is paraphrase more than prediction.",
        ),
    },
    "Links": {
        "cross_fitted": (
            "cross-fitted",
            "Train recipes are scored by a model that was trained without them: they are cut into folds, and each "
            "fold has a model of all others. Without it an agent learns on answers from memory, and trusts them too "
            "much.",
        ),
        "inductive": (
            "inductive",
            "Of entities that the graph does not have, from the words of their labels; transductive is what knows "
            "the entities of its graph only.",
        ),
        "query": ("query", "A triple without its head or without its tail; the model ranks all entities for it."),
        "filtered": (
            "filtered",
            "Other entities that are true answers as well do not compete with the one asked for. Raw ranks let them "
            "compete.",
        ),
        "realistic": (
            "realistic ties",
            "Entities with equal scores share their mean rank, so a model that scores all alike gets the rank of "
            "chance. Optimistic ties rank the true one first, pessimistic ones last.",
        ),
        "mrr": ("MRR", "Mean reciprocal rank: the mean over all queries of 1 / rank of the true entity. 1 is perfect."),
        "hits": ("hits@k", "Share of queries whose true entity is among the first k."),
        "amri": ("AMRI", "Adjusted mean rank index: 0 for the mean rank of chance, 1 for perfect, below 0 for worse."),
        "interval": (
            "95 % CI",
            "Confidence interval: a range that covers the true value in about 95 of 100 such experiments. Of links "
            "it is a bootstrap over recipes, whose triples belong together.",
        ),
        "paired": (
            "paired difference",
            "Both answer the same queries or tasks, and these are resampled as pairs. If the interval of the "
            "difference holds 0, the two are level.",
        ),
        "ece": (
            "ECE",
            "Expected calibration error: how far the confidence of the best candidate is from how often it is right,"
            " on average.",
        ),
        "calibrated": (
            "probability of a triple",
            "Of a triple that training does not contain: the chance that a recipe of the book gives it. Of those "
            "that get 10 %, about a tenth should be true (calibrated).",
        ),
        "speaks_for": (
            "what speaks for a link",
            "Links of training with the same head or tail, whose other end is to the model like that of the link. A "
            "weight says how like: the cube of the cosine of the model's own scores of both. A share is of the sum "
            "of all weights.",
        ),
        "base_rate": (
            "base rate",
            "The share of true ones among all triples outside training: the probability without looking at any score.",
        ),
        "log_loss": (
            "log loss",
            "Mean of -log of the probability that was given to what turned out to be the case, in nats: lower is "
            "better.",
        ),
        "frequency": (
            "frequency rule",
            "Baseline without training: entities by how often they occur in the training triples.",
        ),
        "votes": (
            "vote count",
            "Baseline without training: how often each ingredient has been in a train recipe of the result. It knows"
            " which entity is which, and no word; triples get what is left when the rest of the recipe is summed "
            "out.",
        ),
        "neighbours": (
            "neighbour rule",
            "Baseline without training: asks what entities with the same neighbours in the training graph are linked"
            " to.",
        ),
        "random": ("random order", "Baseline: what chance gives on average, computed instead of sampled."),
        "opinion": (
            "opinion",
            "A pair that a language model names as making an entity when it is asked; the earlier it is named, the "
            "larger its weight. It rests on no recipe of the graph.",
        ),
    },
    "Play": {
        "goal": ("goal", "The entity to make in a task, by picking pairs from a table."),
        "distractor": ("distractor", "An entity on the table that the task does not need."),
        "depth": ("depth", "How many recipes the shortest plan of a task takes."),
        "plan": ("plan", "Recipes that make the goal from the task's starting ingredients."),
        "by_plan": (
            "by a plan",
            "The last pair of one of the task's plans made the goal. Otherwise another pair on the table made it, "
            "perhaps that of a train recipe.",
        ),
        "open_ended": (
            "open-ended world",
            "Play without a goal: whatever is made is known for good, and what counts is how many entities are known"
            " after a number of attempts.",
        ),
        "look_up": (
            "look-up",
            "Asking in a game what is known of a thing: train recipes, or what a scorer believes. It costs no attempt.",
        ),
        "refused": (
            "refused answer",
            "An answer in words that is not understood. The player is told what would be; it costs nothing, but "
            "after several in a row the next one costs an attempt.",
        ),
        "reference_pack": (
            "reference pack",
            "Figures that come with the package: chance, graphs, oracles and agents on the same tasks, and apart "
            "from them people and language models of the literature, on other tasks.",
        ),
        "mcp": (
            "Model Context Protocol, MCP",
            "How programs with a language model call tools of other programs; here they play by it.",
        ),
        "greedy": ("greedy", "The agent takes its best slot each time instead of drawing one."),
        "oracle": ("recipe oracle", "A player that looks the recipes up; nothing can be better."),
    },
    "Agents": {
        "evidence": (
            "evidence",
            "What known recipes say about another one, on which its recipe score rests among others. Each is shown "
            "with how like it is (both ingredients and the result; 1 is the same) and its share of all that is said.",
        ),
        "lambda": ("mixing weight", "How much a source counts, which the agent learns: λα, λu, λv, λw.", "λ"),
        "beta": ("logit", "The sum of a slot's scores, each times its mixing weight: λα·α + λu·u + λv·v + λw·w.", "β"),
        "pi": ("probability", "Chance of a slot to be picked in training: the softmax of the logits.", "π"),
        "value": ("state value", "The return that the agent expects from here on.", "V"),
        "return": ("return", "Sum of the rewards of an episode."),
        "entropy": (
            "entropy",
            "How undecided the policy is, in nats: 0 if it always takes the same slot, most if all slots are equally"
            " likely.",
        ),
        "grad_norm": ("gradient norm", "Length of the gradient of the loss, before it is clipped."),
        "iqm": ("IQM", "Interquartile mean: the mean of the middle half of the seeds."),
        "p_better": (
            "P(better)",
            "Share of pairs of runs, one of each agent, in which this agent's run is better; ties count half.",
        ),
        "over_seeds": (
            "over seeds",
            "Interval by resampling seeds: how another training would vary. With five seeds it is too narrow and "
            "covers about 84 %.",
        ),
        "over_tasks": (
            "over tasks",
            "Interval by resampling tasks, keeping the draws of a task together: how other tasks would vary. It "
            "ignores that another seed would give another agent.",
        ),
    },
}
GLOSSARY = {
    **{label.name: _term(label) for label in (ALPHA, *BUILT_IN.values())},
    **{key: Term(topic, *term) for topic, terms in _TERMS.items() for key, term in terms.items()},
}
"""Terms by the key that templates use."""


def find_term(key: str) -> Term:
    """Return a word of the glossary, or the words of a source's label.

    Raises:
        KeyError: if there is neither.
    """
    return GLOSSARY[key] if key in GLOSSARY else _term(label_of(key))
