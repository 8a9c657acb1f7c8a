import io
import itertools
import json
import runpy
from pathlib import Path

import pytest
import torch

PLAYER = runpy.run_path(str(Path(__file__).parents[3] / "examples" / "transformers_player.py"))
ITEMS = ["flour", "hot water", "egg", "milk", "sugar"]
RULES = "rules: look up. " + 5 * "flour is a part of bread. "


@pytest.fixture(scope="module")
def reader(model_folder):
    made = PLAYER["Reader"](str(model_folder))
    made.end = made.tokens("bread")[0]
    made.tokenizer.chat_template = "{% for one in messages %}{{ one.content }}, {% endfor %}"
    return made


def log_prob(reader, prompt, answer):
    """Log-probability of an answer after a prompt, read as one text without a cache."""
    ids = [*prompt, *reader.tokens(answer), reader.end]
    rows = reader.model(torch.tensor([ids])).logits[0].log_softmax(-1)
    return sum(float(rows[place - 1, ids[place]]) for place in range(len(prompt), len(ids)))


@torch.inference_mode()
def test_the_answer_is_the_most_probable_untried_pair(
    reader,
):
    """The answer by probabilities is the most probable text of all pairs that were not tried."""
    prompt, tried = reader.tokens("flour is a part of"), set()
    expected = {
        f"{a} + {b}": log_prob(reader, prompt, f"{a} + {b}")
        for a, b in itertools.product(ITEMS, ITEMS)
    }
    for _ in range(15):
        answer = PLAYER["by_probabilities"](reader, prompt, ITEMS, tried)
        assert expected[answer] == pytest.approx(max(expected.values()), abs=1e-4)
        for text in [
            text for text in expected if sorted(text.split(" + ")) == sorted(answer.split(" + "))
        ]:
            del expected[text]
    assert not expected


@torch.inference_mode()
def test_the_answer_by_generation_is_that_of_a_model_without_a_kept_text(reader):
    for text in ("flour is a part of", "flour is hot", "sugar is a part of flour"):
        prompt = reader.tokens(text)
        expected = reader.model.generate(
            torch.tensor([prompt]),
            do_sample=False,
            max_new_tokens=5,
            eos_token_id=reader.end,
            pad_token_id=1,
        )
        written = [token for token in expected[0, len(prompt) :].tolist() if token != reader.end]
        assert PLAYER["by_generation"](reader, prompt, 5) == reader.tokenizer.decode(
            written, skip_special_tokens=True
        )


@pytest.mark.parametrize("by", ["generation", "probabilities"])
def test_equal_games_get_equal_answers_and_a_full_context_begins_anew(
    reader, by, monkeypatch, capsys
):
    state = {"goal": "bread", "table": ITEMS, "attempts_left": 9}
    game = [
        {**state, "text": f"{RULES}\n\nbread", "new": True},
        *[{**state, "text": "egg", "new": False}] * 9,
    ]
    monkeypatch.setattr(
        "sys.stdin", io.StringIO("".join(json.dumps(line) + "\n" for line in game + game))
    )
    PLAYER["play"](reader, by, 80, 4)
    answers = capsys.readouterr().out.splitlines()
    assert len(answers) == 20
    assert answers[:10] == answers[10:]
    assert len(reader.ids) <= 80
    if by == "probabilities":
        assert answers[0] == "look up bread"
        assert len(set(answers)) == 10
