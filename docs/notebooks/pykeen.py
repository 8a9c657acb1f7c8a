# %% [markdown]
# # PyKEEN with a recipe graph
#
# PyKEEN finds every recipe graph as the dataset `wordcraft`, and a model from its pipeline becomes a model folder for
# all commands. [Link prediction](../link-prediction.md) is the guide.

# %%
import pandas as pd
import torch
from pykeen.datasets import get_dataset
from pykeen.pipeline import pipeline

from wordcraft_kg import (
    ComplExConfig,
    LinksConfig,
    RecipesConfig,
    from_pykeen,
    open_graph,
    open_model,
    save_scorer,
    train_links,
    train_recipes,
)
from wordcraft_kg.evaluation.ranked_links import Contender, compare
from wordcraft_kg.models.scorers.baselines import FrequencyScorer

torch.set_num_threads(1)  # more threads are slower on models this small
opened = open_graph("kitchen")
get_dataset(dataset="wordcraft", dataset_kwargs={"graph": "kitchen"})

# %% [markdown]
# ## PyKEEN's pipeline

# %%
result = pipeline(
    dataset="wordcraft",
    dataset_kwargs={"graph": "kitchen"},
    model="TransE",
    epochs=50,
    random_seed=0,
    training_kwargs={"batch_size": 256, "use_tqdm": False},
    evaluation_kwargs={"use_tqdm": False},
)
print(f"MRR by PyKEEN: {result.get_metric('both.realistic.inverse_harmonic_mean_rank'):.3f}")

# %% [markdown]
# The pipeline's MRR has no interval. `save_scorer` writes the model as a folder, for the comparison below, the report
# (`wordcraft-kg evaluate-links models/transe`), the explorer and agents.

# %%
save_scorer("models/transe", from_pykeen(result.model, result.training, opened), opened, kg="partial")

# %% [markdown]
# ## A fair comparison
#
# The paper's ComplEx, a recipe scorer, and a baseline that counts how often an entity occurs, on the same triples.

# %%
train_links(LinksConfig("kitchen", ComplExConfig()), "models/complex")
train_recipes(RecipesConfig("kitchen"), "models/recipes")
counting = FrequencyScorer(opened.graph, opened.split.partial, name="frequency")
save_scorer("models/frequency", counting, opened, kg="partial")

names = ("frequency", "transe", "complex", "recipes")
comparison = compare([Contender(name, [open_model(f"models/{name}")]) for name in names])
pd.DataFrame(
    {
        model.name: {
            "MRR": f"{model.mrr:.3f} [{model.mrr_ci[0]:.3f}, {model.mrr_ci[1]:.3f}]",
            "difference to frequency": "{:+.3f} [{:+.3f}, {:+.3f}]".format(model.difference, *model.difference_ci)
            if model.difference_ci
            else "",
        }
        for model in comparison.models
    }
).T

# %%
others = ", ".join(comparison.not_significant) or "no other model"
print(f"{comparison.triples} unseen triples; the best model is {comparison.best}; no significant difference: {others}")

# %% [markdown]
# ## Predictions
#
# The best predicted ingredients for bread. `train` triples were in training.

# %%
known = {tuple(triple) for triple in opened.split.partial.tolist()}
id_of = opened.graph.id_of
rows = []
for name in names[1:]:
    for entity, score in open_model(f"models/{name}").scorer.top(None, "componentOf", "bread", limit=5):
        is_train = (id_of(entity), 1, id_of("bread")) in known
        rows.append((name, entity, round(score, 2), "train" if is_train else "new or test"))
pd.DataFrame(rows, columns=["model", "entity", "score", "triple"]).set_index(["model", "entity"])
