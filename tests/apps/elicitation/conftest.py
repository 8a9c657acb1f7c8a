"""A tiny language model and a tiny encoder with random weights, whose words are those of the
kitchen.

Fixtures import transformers: each process of the tests collects all files, and one of them tests
those here.
"""

import pytest
import torch

from wordcraft_kg.apps.elicitation.language_model import DEFAULT, read_prompts

SIZES = {
    "hidden_size": 16,
    "num_hidden_layers": 2,
    "num_attention_heads": 2,
    "intermediate_size": 16,
}


def save(folder, kind, config, tokenizer):
    # Large weights, so that labels differ in their probabilities.
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        kind(config).save_pretrained(folder)
    tokenizer.save_pretrained(folder)
    return folder


@pytest.fixture(scope="session")
def tokenizer(kitchen):
    from tokenizers import Tokenizer, models, pre_tokenizers
    from transformers import PreTrainedTokenizerFast

    texts = [
        text for prompt in read_prompts(DEFAULT) for text in (prompt.text("a"), *prompt.neutral)
    ]
    words = sorted(
        {word for text in (*kitchen.entities, *texts) for word in text.replace(",", " ,").split()}
    )
    words += [label.capitalize() for label in kitchen.entities]
    vocabulary = {
        word: number for number, word in enumerate(dict.fromkeys(("[UNK]", "[PAD]", *words)))
    }
    made = Tokenizer(models.WordLevel(vocabulary, unk_token="[UNK]"))
    made.pre_tokenizer = pre_tokenizers.Whitespace()
    return PreTrainedTokenizerFast(tokenizer_object=made, unk_token="[UNK]", pad_token="[PAD]")


@pytest.fixture(scope="session")
def model_folder(tokenizer, tmp_path_factory):
    """A causal language model; read only."""
    from transformers import LlamaConfig, LlamaForCausalLM

    config = LlamaConfig(vocab_size=len(tokenizer), initializer_range=0.5, **SIZES)
    return save(tmp_path_factory.mktemp("lm"), LlamaForCausalLM, config, tokenizer)


@pytest.fixture(scope="session")
def masked_folder(tokenizer, tmp_path_factory):
    """A masked language model, which sees later words; read only."""
    from transformers import BertConfig, BertForMaskedLM

    config = BertConfig(vocab_size=len(tokenizer), initializer_range=0.5, **SIZES)
    return save(tmp_path_factory.mktemp("masked"), BertForMaskedLM, config, tokenizer)


@pytest.fixture(scope="session")
def encoder_folder(tokenizer, tmp_path_factory):
    """An encoder without a pooling of its own; read only."""
    from transformers import BertConfig, BertModel

    config = BertConfig(vocab_size=len(tokenizer), initializer_range=0.5, **SIZES)
    return save(tmp_path_factory.mktemp("encoder"), BertModel, config, tokenizer)
