# %% [markdown]
# # Planning: goals that need several attempts
#
# A goal of depth 2 needs an intermediate first. A recipe scorer values pairs for the goal alone; the planner searches
# for the most probable plan with the same scorer. [Planning](../planning.md) is the guide, with larger books.

# %%
import numpy as np
import pandas as pd

from wordcraft_kg import (
    AgentConfig,
    ImpalaConfig,
    PolicyConfig,
    RecipesConfig,
    TaskConfig,
    World,
    evaluate,
    load_policy,
    load_scorer,
    make_sources,
    open_graph,
    train_agent,
    train_recipes,
)
from wordcraft_kg.agents.explanation import Explainer
from wordcraft_kg.agents.players import knowledge_player, random_distinct, recipe_oracle
from wordcraft_kg.planning.source import BestPlan

opened = open_graph("kitchen")
train_recipes(RecipesConfig("kitchen"), "models/recipes")
scorer = load_scorer("models/recipes")

# %% [markdown]
# ## Success by depth
#
# Four distractors, and as many attempts as the depth. The planner with train recipes alone has no learned knowledge:
# it makes a goal if train recipes lead there.

# %%
players = {
    "chance": random_distinct,
    "w: the best pair": knowledge_player(make_sources(["recipe"], scorer)),
    "planner, train recipes only": knowledge_player(
        [BestPlan.of_recipes(len(opened.graph), opened.split.recipes("train"))]
    ),
    "planner": knowledge_player(make_sources(["plan"], scorer)),
    "recipe oracle": recipe_oracle,
}
results = {}
for depth in (1, 2, 3):
    world = World(opened, TaskConfig(depth=depth, distractors=4).environment("test"))
    for name, player in players.items():
        results[name, depth] = evaluate(player, world, distractor_seeds=1)


def figure(result):
    figures = result.metrics()
    return f"{figures.mean:.3f} [{figures.ci_low:.3f}, {figures.ci_high:.3f}]"


table = pd.Series({key: figure(result) for key, result in results.items()}).unstack()
table.columns = [f"depth {depth}, {len(results['planner', depth].tasks)} tasks" for depth in table.columns]
table.loc[list(players)]

# %% [markdown]
# Test tasks at depth 2 by the least number of unseen recipes in a plan:

# %%
world = World(opened, TaskConfig(depth=2, distractors=4).environment("test"))
is_unseen = ~opened.split.is_in("train")
fewest = pd.Series(
    [min(is_unseen[list(plan)].sum() for plan in plans) for plans in world.tasks.plans], name="unseen recipes"
)
shares = {name: pd.Series(results[name, 2].success[:, 0]).groupby(fewest).mean() for name in players}
pd.DataFrame({"tasks": fewest.value_counts().sort_index()} | shares).round(3)

# %% [markdown]
# ## An agent that plans
#
# An agent with the source plan (p) begins as the planner and learns from play. The agent here is trained for a moment,
# and has no significant difference from the planner.

# %%
tasks, trainer = TaskConfig(depth=2, distractors=4), ImpalaConfig(steps=10_000, eval_every=0)
all_sources = PolicyConfig(use="combines,component,recipe,plan")
train_agent(AgentConfig("kitchen", "models/recipes", tasks, all_sources, trainer), "runs/deep")
policy = load_policy("runs/deep")
agent = evaluate(policy, world, distractor_seeds=1)
pd.Series({"agent with u, v, w, p": figure(agent), "planner": figure(results["planner", 2])}, name="depth 2").to_frame()

# %% [markdown]
# Explanations show each item's most probable plan, with a probability for each expected result. Here the task's plan
# has a test recipe, and the agent makes the goal.

# %%
explainer = Explainer(policy, world)
won = np.flatnonzero(agent.success[:, 0] & (fewest.to_numpy() == 1))
episode = explainer.episode(int(won[0]))
print(f"goal {episode.goal}; a plan: {', then '.join(episode.plans[0])}")
for step in episode.steps:
    print(
        f"holding {step.selection or 'nothing'}: {step.action}"
        + (f" makes {', '.join(step.made)}" if step.made else "")
    )
    for entity, evidence in step.best_evidence(2):
        print(f"    {entity}: {', then '.join(map(str, evidence.plan))}")
