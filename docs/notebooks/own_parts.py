# %% [markdown]
# # Own scorer, source, split and player
#
# Each part is a class or a function, here on the book `kitchen`. A
# package registers its parts by entry points: see `CONTRIBUTING.md` and `examples/`.

# %%
import numpy as np
import pandas as pd
import torch

from wordcraft_kg import (
    AgentConfig,
    ImpalaConfig,
    PolicyConfig,
    SplitConfig,
    TaskConfig,
    evaluate,
    load_policy,
    make_sources,
    open_graph,
    save_scorer,
    train_agent,
)
from wordcraft_kg.agents.players import knowledge_player, pair_player
from wordcraft_kg.evaluation.links import view_links
from wordcraft_kg.evaluation.ranked_links import rank_links
from wordcraft_kg.graphs.splits import SPLITS, SplitKind
from wordcraft_kg.models.policies.sources import Label
from wordcraft_kg.models.policies.sources.registry import register_source
from wordcraft_kg.models.policies.sources.source import Source
from wordcraft_kg.models.scorers.features import glove_features
from wordcraft_kg.models.scorers.scorer import Scorer

opened = open_graph("kitchen")


def success(player, graph=opened):
    figures = evaluate(player, graph, num_distractors=4).metrics()
    return f"{figures.mean:.3f} [{figures.ci_low:.3f}, {figures.ci_high:.3f}]"


# %% [markdown]
# ## A scorer
#
# A scorer rates triples. This one knows no recipe: entities are linked if their words are used alike.


# %%
class AlikeScorer(Scorer):
    """Cosine of the GloVe vectors of head and tail."""

    def __init__(self, opened):
        super().__init__(opened.graph.entities, opened.graph.hash, name="alike")
        self.unit = torch.tensor(glove_features(opened.graph.entities).unit_vectors)

    def _score(self, heads, relations, tails):
        return (self.unit[heads] * self.unit[tails]).sum(dim=-1) + 0 * relations


scorer = AlikeScorer(opened)
scorer.top("butter", "combinesWith", None, limit=4)

# %% [markdown]
# The link report ranks the unseen triples, next to baselines. `save_scorer` writes a model folder for all commands.

# %%
view = view_links(rank_links(scorer, opened, kg="none"))
mrr = {"alike": view.metrics["all"].mrr} | {name: row["all"].mrr for name, row in view.baselines.items()}
print("95 % interval of alike: [{:.3f}, {:.3f}]".format(*view.metrics["all"].mrr_ci))
pd.Series(mrr, name="MRR on unseen triples").round(3).to_frame()

# %%
save_scorer("models/alike", scorer, opened, kg="none", origin="cosine of GloVe vectors")

# %% [markdown]
# ## A source
#
# A source scores table slots. This one counts the letters that an entity shares with the goal.
# `register_source` makes its name known to `PolicyConfig(use="combines,component,letters")`.


# %%
@register_source
class SharedLetters(Source):
    """Number of letters that an entity shares with the goal."""

    label = Label("letters", "x", "letters shared with the goal")

    def __init__(self, num_entities):
        super().__init__(num_entities)
        # One more row and column for empty slots.
        self.register_buffer("shared", torch.zeros(num_entities + 1, num_entities + 1))

    @classmethod
    def of_scorer(cls, scorer, view):
        source, letters = cls(len(scorer.entities)), [set(entity) for entity in scorer.entities]
        source.shared[:-1, :-1] = torch.tensor([[float(len(one & other)) for one in letters] for other in letters])
        return source

    def forward(self, states):
        return self.shared[states.goal[:, None], states.table]


success(knowledge_player(make_sources(["letters"], scorer)))

# %% [markdown]
# Alone the source is worse than chance: it takes the same item twice. An agent learns weights for the sources, and
# attention beside them. Without `in_sample` and folds nothing leaks here, because this scorer has seen no recipe.

# %%
rows = {}
for use in ("u,v", "u,v,letters"):
    trainer = ImpalaConfig(steps=100_000, eval_every=0)
    train_agent(
        AgentConfig("kitchen", "models/alike", TaskConfig(distractors=4), PolicyConfig(use=use), trainer), f"runs/{use}"
    )
    rows[use] = success(load_policy(f"runs/{use}"))
pd.Series(rows, name="success on test tasks").rename_axis("sources of the agent").to_frame()

# %% [markdown]
# ## A player
#
# `pair_player` turns any function that scores recipes into a player; the arguments are id tensors.


# %%
def first_slots(state, rng):
    """Choose the first item, then the second."""
    return (state.selection != state.nothing).astype(np.int64)


def alike_pair(a, b, goal):
    """Prefer two different items whose words are used like the goal's word."""
    return scorer.score(a, "componentOf", goal) + scorer.score(b, "componentOf", goal) - 2.0 * (a == b)


players = {"first slots": first_slots, "pair like the goal": pair_player(alike_pair)}
pd.Series({name: success(player) for name, player in players.items()}, name="success on test tasks").to_frame()

# %% [markdown]
# ## A split
#
# This split holds out results by their first letter, so no train recipe makes a test goal.


# %%
def first_letters(graph):
    """Return each recipe's group: the first letter of the result."""
    return np.array([ord(recipe.result[0]) for recipe in graph.recipe_labels()])


SPLITS["by-letter"] = SplitKind(first_letters, "first letters of results are held out")
by_letter = open_graph("kitchen", SplitConfig("by-letter", train_ratio=0.7))
print(by_letter.split)
test = by_letter.graph.recipe_labels(by_letter.split.recipes("test"))
print("first letters of the test goals:", *sorted({recipe.result[0] for recipe in test}))
print("pair like the goal, on these tasks:", success(pair_player(alike_pair), by_letter))
