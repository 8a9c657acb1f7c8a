"""A player for `wordcraft-kg bench run` and `evaluate-agent`.

A language model of `transformers` on this machine.

    wordcraft-kg bench run craft-8-lite --out submission --weights model.gguf --timeout 600 \
        --player "program:python examples/transformers_player.py model.gguf --by probabilities"

The model is a folder, a .gguf file or a name on the Hugging Face hub, with a chat template. By
generation, the model writes an answer of a few tokens, each the most probable. Constrained, it
writes token by token, too, but each token must go on with a text "first + second" of two items on
the table that were not tried in this game, so no answer is invalid. By probabilities, the answer is
the most probable of these texts as a whole. In both, if look-ups are offered, the goal is looked up
first (the first item in open-ended games). The rules and, while they fit, all turns are the
context.

By recipes, the model reads no rules: the answer is the untried pair for which the text "Recipe:
goal = first + second" is the most probable, both orders together. An item with itself comes after
all other pairs: a language model likes to repeat a word. So play models that
examples/finetune_language_model.py taught the train recipes.
"""

import argparse
import json
import sys
from functools import cached_property

import numpy as np
import torch
from chat_template import ChatTemplate, usual_template
from transformers import DynamicCache
from transformers.utils import logging

from wordcraft_kg.apps.elicitation.foreign_code import locate_model, working
from wordcraft_kg.apps.elicitation.language_model import open_language_model
from wordcraft_kg.base.errors import ArtefactError, WordCraftKGError

Message = dict[str, str]
ANSWERS = 200
"""Answers in a forward pass."""


class Reader:
    """A language model that has read a text, which stays in the key-value cache.

    ``next`` holds the log-probabilities of the next token.
    """

    def __init__(self, name: str):
        """Load a model folder, a .gguf file, or a model on the hub.

        Nothing in it runs code, and it is no larger than its weights, see `elicit`.

        Raises:
            WordCraftKGError: for another model, or one without a chat template or an end of a text.
        """
        opened = open_language_model(locate_model("model", name))
        self.model = opened.model
        self.tokenizer = opened.tokenizer
        usual_template(self.tokenizer)
        if self.tokenizer.eos_token_id is None:
            raise ArtefactError(
                f"the tokenizer of '{name}' has no token that ends a text (eos_token): an answer "
                "would not end. Set it in tokenizer_config.json."
            )
        self.end: int = self.tokenizer.eos_token_id
        self.ids: list[int] = []
        self.cache = DynamicCache(config=self.model.config)
        self.next = torch.zeros(0)
        self.counts = {"prompts": 0, "input tokens": 0, "output tokens": 0}

    @cached_property
    def template(self) -> ChatTemplate:
        """The model's chat template."""
        return ChatTemplate(self.tokenizer)

    def tokens(self, text: str) -> list[int]:
        """Return the tokens of a part of an answer."""
        with working(self.tokenizer.name_or_path):
            return list(self.tokenizer(text, add_special_tokens=False).input_ids)

    def chat(self, messages: list[Message], is_asked: bool) -> list[int]:
        """Return the tokens of a conversation.

        They end with the beginning of an answer if the model is asked for one.
        """
        return self.tokens(self.template.render(messages, is_asked=is_asked))

    def cut(self, length: int) -> None:
        """Forget the text after the first ``length`` tokens."""
        if forgotten := len(self.ids) - length:
            self.cache.crop(-forgotten)
        self.ids = self.ids[:length]

    def read(self, ids: list[int]) -> None:
        """Read a text in place of the last text; an equal beginning stays in the cache."""
        both = zip(self.ids, ids[:-1], strict=False)
        self.cut(
            next(
                (n for n, (old, new) in enumerate(both) if old != new),
                min(len(self.ids), len(ids) - 1),
            )
        )
        new = torch.tensor([ids[len(self.ids) :]])
        with working(self.tokenizer.name_or_path):  # such as tokens beyond the rows of the weights
            output = self.model(input_ids=new, past_key_values=self.cache, logits_to_keep=1)
        logits = output.logits
        self.ids, self.next = ids, logits[0, -1].log_softmax(-1)

    def log_probs(self, texts: list[list[int]]) -> list[float]:
        """Return the log-probability of each text (tokens) as the continuation.

        One forward pass over a tree of texts.

        Equal beginnings are read once, and a token sees only its own beginning. What is read counts
        as input.
        """
        begun = list(
            dict.fromkeys(tuple(text[:size]) for text in texts for size in range(1, len(text)))
        )
        row = {beginning: number for number, beginning in enumerate(begun, 1)} | {(): 0}
        unseen = torch.full((len(begun), len(self.ids) + len(begun)), -torch.inf)
        unseen[:, : len(self.ids)] = 0
        for beginning in begun:
            before = [
                len(self.ids) + row[beginning[:size]] - 1 for size in range(1, len(beginning) + 1)
            ]
            unseen[row[beginning] - 1, before] = 0
        logits = self.model(
            input_ids=torch.tensor([[beginning[-1] for beginning in begun]]),
            attention_mask=unseen[None, None],
            position_ids=torch.tensor(
                [[len(self.ids) + len(beginning) - 1 for beginning in begun]]
            ),
            past_key_values=self.cache,
        ).logits[0]
        self.counts["input tokens"] += len(begun)
        self.cache.crop(-len(begun))
        rows = torch.cat([self.next[None], logits.log_softmax(-1)])
        return [
            float(rows[[row[tuple(text[:size])] for size in range(len(text))], text].sum())
            for text in texts
        ]


def by_generation(reader: Reader, prompt: list[int], most: int) -> str:
    """Return the model's answer of at most ``most`` tokens, each the most probable."""
    answer: list[int] = []
    reader.read(prompt)
    while len(answer) < most and (token := int(reader.next.argmax())) != reader.end:
        answer.append(token)
        reader.read([*prompt, *answer])
    reader.counts["output tokens"] += len(answer)
    return str(reader.tokenizer.decode(answer, skip_special_tokens=True))


def by_constraint(
    reader: Reader, prompt: list[int], items: list[str], tried: set[frozenset[str]]
) -> str:
    """Return an answer "first + second" written token by token; its pair was not tried.

    Of all tokens with which some allowed answer goes on, the most probable is taken. The first item
    is decided first, so that the texts of all pairs are never made.
    """

    def written(texts: list[str]) -> str:
        """Return the text that the model writes if it may write only these."""
        left = {text: [*reader.tokens(text), reader.end] for text in texts}
        place = 0
        while len(left) > 1:
            nexts = {tokens[place] for tokens in left.values()}
            if len(nexts) > 1:
                one = next(iter(left.values()))
                reader.read([*prompt, *one[:place]])  # equal in all texts that are left
            token = max(sorted(nexts), key=lambda token: float(reader.next[token]))
            left = {text: tokens for text, tokens in left.items() if tokens[place] == token}
            place += 1
        (chosen,) = left
        reader.counts["output tokens"] += len(left[chosen]) - 1
        return chosen

    def partners(first: str) -> list[str]:
        return [other for other in items if frozenset((first, other)) not in tried]

    firsts = {f"{first} +": first for first in items if partners(first)}
    first = firsts[written(list(firsts))]
    answer = written([f"{first} + {other}" for other in partners(first)])
    tried.add(frozenset(answer.split(" + ")))
    return answer


def by_probabilities(
    reader: Reader, prompt: list[int], items: list[str], tried: set[frozenset[str]]
) -> str:
    """Return the most probable answer "first + second" whose pair was not tried.

    No answer is more probable than its first half, so the search may end before it has read all
    answers.
    """
    reader.read(prompt)
    halves = reader.log_probs([reader.tokens(f"{item} +") for item in items])
    order = sorted(zip(halves, items, strict=True), reverse=True)
    best, chosen = -torch.inf, ""
    some = max(1, ANSWERS // len(items))
    for start in range(0, len(order), some):
        if order[start][0] <= best:
            break
        firsts = [first for _, first in order[start : start + some]]
        answers = [
            f"{one} + {other}"
            for one in firsts
            for other in items
            if frozenset((one, other)) not in tried
        ]
        scores = reader.log_probs([[*reader.tokens(answer), reader.end] for answer in answers])
        best, chosen = max((best, chosen), *zip(scores, answers, strict=True))
    tried.add(frozenset(chosen.split(" + ")))
    return chosen


def by_recipes(reader: Reader, goal: str, items: list[str], tried: set[frozenset[str]]) -> str:
    """Return the untried pair whose recipe, as a text in either order, is the most probable.

    Pairs of an item with itself come last. Of left-out train recipes the tuned SmolLM2-135M found
    57 of 100 with them and 74 without, though they are a fiftieth of the recipes.
    """
    reader.read(reader.tokens(f"Recipe: {goal} ="))
    answers = [
        (one, other) for one in items for other in items if frozenset((one, other)) not in tried
    ]
    texts = [reader.tokens(f" {one} + {other}") for one, other in answers]
    scores: dict[frozenset[str], float] = {}
    for answer, score in zip(answers, reader.log_probs(texts), strict=True):
        # A pair of different items has two texts, an item with itself one.
        pair = frozenset(answer)
        scores[pair] = float(np.logaddexp(scores.get(pair, -np.inf), score))
    allowed = [pair for pair in scores if len(pair) == 2] or list(scores)
    best = max(allowed, key=lambda pair: scores[pair])
    chosen = next(answer for answer in answers if frozenset(answer) == best)
    tried.add(frozenset(chosen))
    return f"{chosen[0]} + {chosen[1]}"


@torch.inference_mode()
def play(reader: Reader, by: str, context: int, most: int) -> None:
    """Answer the lines on stdin."""
    messages: list[Message] = []
    tried: set[frozenset[str]] = set()
    for line in sys.stdin:
        message = json.loads(line)
        text = message["text"]
        if message["new"]:
            rules, _, text = text.partition("\n\n")
            messages, tried = [{"role": "system", "content": rules}], set()
            # The rules are the same in all games. Nothing else stays, so no game depends on the
            # games before.
            if reader.ids[: len(kept := reader.chat(messages, False))] == kept:
                reader.cut(len(kept))
            else:
                reader.read(kept)
        messages.append({"role": "user", "content": text})
        if len(prompt := reader.chat(messages, True)) > context - most:
            del messages[1:-1]
            prompt = reader.chat(messages, True)
        if by != "generation" and message["new"] and "look up" in messages[0]["content"]:
            answer = f"look up {message['goal'] or message['table'][0]}"
        else:
            reader.counts["prompts"] += 1
            reader.counts["input tokens"] += len(prompt)
            if by == "generation":
                answer = by_generation(reader, prompt, most)
            elif by == "constrained":
                answer = by_constraint(reader, prompt, message["table"], tried)
            else:
                answer = by_probabilities(reader, prompt, message["table"], tried)
        messages.append({"role": "assistant", "content": answer})
        # A JSON string holds the whole answer in one line.
        print(json.dumps(answer), flush=True)


@torch.inference_mode()
def play_by_recipes(reader: Reader) -> None:
    """Answer the lines on stdin by the probabilities of recipes as texts."""
    tried: set[frozenset[str]] = set()
    for line in sys.stdin:
        message = json.loads(line)
        if not message["goal"]:
            sys.exit("error: this game has no goal, so no recipe to write; choose another --by.")
        if message["new"]:
            tried = set()
        answer = by_recipes(reader, message["goal"], message["table"], tried)
        reader.counts["prompts"] += 1
        reader.counts["input tokens"] += len(reader.ids)
        print(answer, flush=True)


def main() -> None:
    """Play with the model that the command line names."""
    parser = argparse.ArgumentParser(
        description="A language model of transformers as a player of the line protocol."
    )
    parser.add_argument("model", help="model folder, .gguf file, or a name on the Hugging Face hub")
    ways = ["generation", "constrained", "probabilities", "recipes"]
    parser.add_argument("--by", choices=ways, default="generation")
    parser.add_argument(
        "--context", type=int, default=2048, help="tokens of a conversation, before it begins anew"
    )
    parser.add_argument("--new-tokens", type=int, default=12, help="most tokens of an answer")
    options = parser.parse_args()
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    player = Reader(options.model)
    if options.by == "recipes":
        play_by_recipes(player)
    else:
        play(player, options.by, options.context, options.new_tokens)
    print(", ".join(f"{count:,} {name}" for name, count in player.counts.items()), file=sys.stderr)


if __name__ == "__main__":
    try:
        main()
    except WordCraftKGError as error:
        sys.exit(f"error: {error}")
