# %% [markdown]
# # Fine-tune a language model, and measure it
#
# Recipes, a model that learns them as text, a track of the benchmark, a verified
# submission, with a toy in place of your weights.
# [Train or measure your language model](../language-models.md) is the guide. Start it in the repository's folder.

# %%
import json
import subprocess
import sys
from pathlib import Path

import torch
from tokenizers import Tokenizer, models, pre_tokenizers
from transformers import LlamaConfig, LlamaForCausalLM, PreTrainedTokenizerFast

from wordcraft_kg import open_graph
from wordcraft_kg.apps.text_agents.submission import metrics_text, verify
from wordcraft_kg.cli import main
from wordcraft_kg.models.scorers.features import glove_features

graph = open_graph("everyday").graph
words = sorted({word for entity in graph.entities for word in entity.split()})
print(f"{graph.num_recipes:,} recipes of {graph.num_entities:,} items")

# %% [markdown]
# A toy: a token for each word, two layers, and GloVe vectors as embeddings, so that it knows words but no text.
# **Your weights:** leave this cell out, and use a folder, a `.gguf` file or
# a name on the Hugging Face hub with a chat template, such as SmolLM2-135M-Instruct.

# %%
signs = ["<unknown>", "<end>", "Recipe:", "=", "+"]
vocabulary = {word: number for number, word in enumerate([*signs, *words])}
splitter = Tokenizer(models.WordLevel(vocabulary, unk_token="<unknown>"))
splitter.pre_tokenizer = pre_tokenizers.WhitespaceSplit()
tokenizer = PreTrainedTokenizerFast(
    tokenizer_object=splitter, unk_token="<unknown>", eos_token="<end>"
)
tokenizer.chat_template = "{% for message in messages %}{{ message.content }} {% endfor %}"
torch.manual_seed(0)
toy = LlamaForCausalLM(
    LlamaConfig(
        vocab_size=len(vocabulary),
        hidden_size=50,
        intermediate_size=200,
        num_hidden_layers=2,
        num_attention_heads=5,
        eos_token_id=1,
        tie_word_embeddings=True,
        initializer_range=0.1,
    )
)
vectors = torch.tensor(glove_features(words).vectors)
with torch.no_grad():
    embeddings = toy.model.embed_tokens.weight
    embeddings[: len(signs)].normal_(0, 0.5)
    embeddings[len(signs) :] = 0.5 * (vectors - vectors.mean(0)) / vectors.std()
toy.save_pretrained("toy")
tokenizer.save_pretrained("toy")
print(f"{toy.num_parameters():,} weights")

# %% [markdown]
# ## Recipes as text
#
# The script reads train recipes alone, as `Recipe: goal = first + second`, and leaves a twentieth of them out, to
# choose settings by. In a terminal:
#
#     python examples/finetune_language_model.py toy everyday --out tuned --epochs 8 --lr 1e-2

# %%
line = ["examples/finetune_language_model.py", "toy", "everyday", "--out", "tuned"]
subprocess.run(
    [sys.executable, *line, "--epochs", "8", "--lr", "1e-2"], check=True, capture_output=True
)
training = json.loads(Path("tuned/training.json").read_text())
print(f"learned {training['recipes']:,} recipes, {training['tokens']:,} tokens")
for split in training["splits"]:
    print(f"{split['kind']}: {split['right']} of {split['asked']} recipes that were left out")

# %% [markdown]
# ## Play, and verify
#
# By recipes, the player combines the pair whose text is the most probable. The untuned toy guesses.

# %%
for folder in ("toy", "tuned"):
    player = f"program:'{sys.executable}' examples/transformers_player.py {folder} --by recipes"
    run = ["bench", "run", "craft-1-lite", "--player", player, "--out", f"played-{folder}"]
    weights = ["--weights", f"{folder}/model.safetensors", "--name", folder, "--quiet"]
    assert main([*run, *weights]) == 0

# %% [markdown]
# A submission has the hash of the weights and all games, which verification plays again:

# %%
for folder in ("toy", "tuned"):
    submission = verify(Path(f"played-{folder}"))
    weights = submission.weights["model.safetensors"][:12]
    print(f"{folder}: {metrics_text(submission.figures)}, weights {weights}")

# %% [markdown]
# SmolLM2-135M-Instruct, fine-tuned by the same script, makes .860 of this track:
# [What do language models know?](../evidence/language-models.md#finetuned)
