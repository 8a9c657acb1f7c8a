# %% [markdown]
# # Train, compare and explain agents
#
# Agents without a graph and agents with a recipe scorer, compared on unseen recipes, and a decision explained.
# [Agents](../agents.md) is the guide.

# %%
from pathlib import Path

import pandas as pd
from IPython.display import SVG

from wordcraft_kg import (
    AgentConfig,
    ImpalaConfig,
    PolicyConfig,
    RecipesConfig,
    TaskConfig,
    World,
    evaluate,
    load_scorer,
    make_sources,
    open_agent,
    open_graph,
    train_agent,
    train_recipes,
)
from wordcraft_kg.agents.explanation import Explainer
from wordcraft_kg.agents.players import knowledge_player, knowledge_players
from wordcraft_kg.evaluation.agents import group_agents, view_agents
from wordcraft_kg.reports import charts
from wordcraft_kg.reports.agent_report import make_agent_report

opened = open_graph("kitchen")
tasks = TaskConfig(distractors=4)
opened.split

# %% [markdown]
# ## Train
#
# Three seeds and 100,000 steps, where the paper has 3,000,000. On a train task the agent reads scores by a model
# without the task's recipe, and so learns how far to trust scores for unseen recipes.

# %%
train_recipes(RecipesConfig("kitchen"), "models/recipes")
for seed in range(3):
    trainer = ImpalaConfig(steps=100_000, eval_every=25_000, seed=seed)
    train_agent(AgentConfig("kitchen", tasks=tasks, trainer=trainer), f"runs/no-graph/seed-{seed}")
    guided = AgentConfig("kitchen", "models/recipes", tasks, PolicyConfig(use="combines,component,recipe"), trainer)
    train_agent(guided, f"runs/guided/seed-{seed}")

# %% [markdown]
# ## Compare
#
# All players play the same test tasks at the same tables; intervals are 95 % over tasks.

# %%
agents = [open_agent(path) for path in sorted(Path("runs").glob("*/*"))]
scripted = knowledge_players(opened.split)
players = {name: scripted[name] for name in ("random", "nearest words (minilm)", "partial KG, votes")}
players["recipe scorer alone"] = knowledge_player(make_sources(["recipe"], load_scorer("models/recipes")))
players |= {agent.name: agent.policy for agent in agents}


def success(player, **settings):
    figures = evaluate(player, opened, **settings).metrics()
    return f"{figures.mean:.3f} [{figures.ci_low:.3f}, {figures.ci_high:.3f}]"


pd.DataFrame(
    {
        f"distractors: {distractors}": {
            name: success(player, num_distractors=distractors) for name, player in players.items()
        }
        for distractors in (1, 4)
    }
)

# %% [markdown]
# The scorer explains nearly all success of the guided agents. The report by `wordcraft-kg compare` has the figures
# over seeds:

# %%
report = make_agent_report(view_agents(group_agents(agents), distractors=[4]))
rows = {}
for agent in report.view.agents:
    figures = agent.success["4"]
    low, high = figures.difference_ci or (None, None)
    difference = "" if low is None else f"{figures.difference:+.3f} [{low:+.3f}, {high:+.3f}]"
    rows[agent.name] = {"seeds": len(agent.seeds), "success": f"{figures.mean:.3f}", "difference": difference}
pd.DataFrame(rows).T

# %%
title = "Success on train and test tasks over training"
SVG(charts.as_file([("", report.pictures["curves"])], title))

# %% [markdown]
# ## Explain
#
# *cheese + tomato -> pizza* is a test recipe. Each item's logit is a sum: attention (alpha) and the
# scorer's scores of links (u, v) and recipes (w), each times the agent's weight.

# %%
agent = agents[0]
explainer = Explainer(agent.policy, World(opened, tasks.environment("test")))
episode = explainer.table("pizza", ["bread", "cheese", "plant", "tomato", "water"]).episode
step = episode.steps[0]
table = pd.DataFrame(
    [slot.contributions | {"logit": slot.logit, "probability": slot.probability} for slot in step.slots]
)
table.index = [slot.entity for slot in step.slots]
table.sort_values("logit", ascending=False).round(3)

# %%
print(f"goal {episode.goal}; attempts: {' + '.join(step.action for step in episode.steps)}; outcome: {episode.outcome}")
for entity, evidence in step.best_evidence():
    print(f"{entity} + {evidence.partner} because of")
    for witness in evidence.because:
        print(f"    {witness.ingredient_a} + {witness.ingredient_b} -> {witness.result} ({witness.share:.0%})")
