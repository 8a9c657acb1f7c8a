# %% [markdown]
# # Graph statistics with pandas and networkx
#
# Recipe table, triples and networkx graph of the built-in
# book `everyday`. [Recipe books and graphs](../graphs.md) is the guide.

# %%
import networkx as nx
import pandas as pd

from wordcraft_kg import open_graph
from wordcraft_kg.graphs import Planner
from wordcraft_kg.graphs.export import to_networkx, triples_frame
from wordcraft_kg.graphs.graph_folder import entities_frame

opened = open_graph("everyday")
graph, split = opened.graph, opened.split
graph

# %% [markdown]
# ## Recipes as a table
#
# A pair may have several results; all its recipes are in the same part.

# %%
recipes = pd.DataFrame(graph.recipe_labels(), columns=["ingredient_a", "ingredient_b", "result"])
recipes["part"] = pd.Categorical.from_codes(split.parts, ["train", "valid", "test"])
recipes.head()

# %%
pairs = recipes.groupby(["ingredient_a", "ingredient_b"])
pairs.size().value_counts().rename_axis("results").rename("pairs").to_frame()

# %%
assert (pairs["part"].nunique() == 1).all()
recipes["part"].value_counts().rename("recipes").to_frame()

# %% [markdown]
# ## Entities
#
# The layer counts crafting rounds from the base; the second table shows every other layer.

# %%
entities = entities_frame(graph)
entities.sort_values("uses", ascending=False).head()

# %%
layers = entities.groupby("layer").agg(entities=("entity", "size"), recipes=("recipes", "mean"), uses=("uses", "mean"))
layers.round(1).iloc[::2]

# %% [markdown]
# The planner finds an entity's cheapest derivation from the base.

# %%
planner = Planner(graph)
print(planner.derivation("pot"))

# %% [markdown]
# ## Triples: full, partial and unseen
#
# All recipes give the *full* triples, train recipes the *partial* triples; *unseen* is the difference. Link
# predictors train on *partial* and are evaluated on *unseen*.

# %%
parts = {"full": opened.triples("full"), "partial": opened.triples("partial"), "unseen": split.unseen}
pd.DataFrame({name: triples_frame(graph, triples)["relation"].value_counts() for name, triples in parts.items()})

# %% [markdown]
# ## The graph in networkx
#
# `to_networkx` has nodes for entities and for recipes, with edges from ingredients to the recipe, and from the recipe
# to the result. Without the nodes for recipes, an edge leads from each ingredient to the result.

# %%
view = to_networkx(graph)
links = nx.DiGraph((a, c) for a, b, c in graph.recipe_labels() for a in (a, b))
largest = max(nx.strongly_connected_components(links), key=len)
print(view)
print(links)
print(f"largest strongly connected component: {len(largest):,} of {len(links):,} entities")
print(f"clustering {nx.average_clustering(links.to_undirected()):.3f}, reciprocal links {nx.reciprocity(links):.3f}")

# %% [markdown]
# Many chains of recipes end at a high PageRank; a high betweenness connects distant entities.

# %%
centrality = pd.DataFrame(
    {"pagerank": nx.pagerank(links), "betweenness": nx.betweenness_centrality(links, k=200, seed=0)}
)
centrality.sort_values("pagerank", ascending=False).head(5).round(4)

# %% [markdown]
# Communities by the Louvain method, each with its most used entities:

# %%
communities = nx.community.louvain_communities(links.to_undirected(), seed=0)
uses = dict(zip(graph.entities, graph.use_counts.tolist(), strict=True))
pd.DataFrame(
    [
        {"entities": len(group), "most used": ", ".join(sorted(group, key=lambda label: (-uses[label], label))[:6])}
        for group in sorted(communities, key=len, reverse=True)
    ]
).head(5)
