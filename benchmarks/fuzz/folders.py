"""Folders of models and agents whose tensors and records were spoilt and whose hashes were mended:
each is refused by an error of the package, or serves as before. Cases run in a process beside, so
that the end of a process is a finding and not the end of the search."""

import json
import random
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from unittest.mock import patch

from .home import copied, mended
from .spoiling import as_json, spoilt_value

BATCH = 200
_WORK = "from benchmarks.fuzz.folders import work; work(*__import__('sys').argv[1:])"


def make_folders(home):
    """Make small models and agents of every kind, whose tensors differ."""
    import torch

    from tests.short_fits import short_fits
    from wordcraft_kg import open_graph, save_policy, save_scorer
    from wordcraft_kg.envs.world import World
    from wordcraft_kg.envs.world_config import WordCraftConfig
    from wordcraft_kg.models.links.link_config import ComplExConfig, LinksConfig
    from wordcraft_kg.models.links.link_training import train_links
    from wordcraft_kg.models.policies.policy_config import PolicyConfig
    from wordcraft_kg.models.policies.policy_folder import make_policy
    from wordcraft_kg.models.policies.sources import registry
    from wordcraft_kg.models.recipes.encoder_fitting import EncoderSchedule, fit_encoder
    from wordcraft_kg.models.recipes.recipe_config import RecipesConfig, RecipeScorerConfig
    from wordcraft_kg.models.recipes.recipe_training import train_recipes
    from wordcraft_kg.models.scorers.baselines import FrequencyScorer
    from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
    from wordcraft_kg.models.scorers.recipes import RecipeScorer
    from wordcraft_kg.models.scorers.scorer_folder import load_scorer
    from wordcraft_kg.planning.search import FEATURES, MAX_ATTEMPTS

    opened = open_graph("kitchen")
    links = LinksConfig("kitchen", ComplExConfig(dim=4, epochs=3, folds=2))
    train_links(links, home / "complex")
    with short_fits():
        recipes = RecipesConfig("kitchen", RecipeScorerConfig(folds=3))
        train_recipes(recipes, home / "recipes")
    # Embeddings, and not a table of their scores.
    with patch("wordcraft_kg.models.scorers.score_limits.TABLE_LIMIT", 1):
        scorers = {name: load_scorer(home / name) for name in ("complex", "recipes")}
    known = scorers["recipes"].whole.knowledge
    generator = torch.Generator().manual_seed(0)
    tiny = EncoderSchedule(used=5, hidden=7, made=4, batch=8, sampled=6, epochs=1)
    encoder = fit_encoder(known.recipes.long().numpy(), known.vectors.float(), generator, tiny)
    with_encoder = RecipeKnowledge.of_recipes(
        known.recipes.long().numpy(), known.vectors.numpy(), known.near_words.numpy(), {}, encoder
    )
    results = torch.full_like(with_encoder.results_second, 0.5)
    constants = with_encoder.constants() | {"results_second": results}
    scorers["encoder"] = RecipeScorer(constants, opened.graph.entities, opened.graph.hash)
    save_scorer(home / "encoder", scorers["encoder"], opened, kg="partial")
    table = FrequencyScorer(opened.graph, opened.split.partial)
    save_scorer(home / "table", table, opened, kg="partial")
    world = World(opened, WordCraftConfig(num_distractors=3, num_tasks=30))
    sizes = {"key_size": 5, "value_size": 4, "hidden_size": 6}
    agents = {
        "agent-tables": ("recipes", {"use": "u,v", "scale": "ranks"}),
        "agent-lists": ("recipes", {"use": "u,v", "scale": "ranks"}),
        "agent-lists-of-one": ("encoder", {"use": "u,v", "scale": "standardise"}),
        "agent-factors": ("complex", {"use": "u,v", "scale": "ranks"}),
        "agent-plan": ("recipes", {"use": "w,p", "sees_attempts": True}),
        "agent-encoder": ("encoder", {"use": "w", "mixing": "residual", "features": "one-hot"}),
        "agent-mlp": (None, {"policy": "mlp", "features": "random"}),
    }
    for name, (scorer, settings) in agents.items():
        with ExitStack() as stack:
            if "lists" in name or "factors" in name:
                stack.enter_context(patch.object(registry, "TABLE_LIMIT", 1))
                stack.enter_context(
                    patch("wordcraft_kg.models.scorers.score_limits.TABLE_LIMIT", 1)
                )
            config = PolicyConfig(**{"self_edges": "drop", **sizes, **settings})
            chosen = scorers[scorer] if scorer else None
            policy, _ = make_policy(config, opened.graph, 5, scorer=chosen, tasks=world.tasks)
        if name == "agent-plan":
            policy.sources["p"].weigh(torch.ones(MAX_ATTEMPTS, len(FEATURES)))
        save_policy(home / name, policy)
    return home


def spoil(folder, rng):
    """Spoil one file or two of a folder, and mend the hashes; return what was done."""
    done = []
    for _ in range(rng.choice((1, 1, 1, 2))):
        names = [path.name for path in sorted(folder.glob("*.json")) if path.name != "run.json"]
        names += [path.name for path in sorted(folder.glob("*.safetensors"))] * 3
        name = rng.choice(names)
        path = folder / name
        if path.suffix == ".json":
            what, value = spoilt_value(json.loads(path.read_text(errors="replace")), rng)
            path.write_bytes(as_json(value))
        else:
            what = _spoil_tensors(path, rng)
        mended(folder, name)
        done.append(f"{name}: {what}")
    return "; ".join(done)


def _spoil_tensors(path, rng):  # noqa: C901 - a list of ways
    import safetensors.torch
    import torch

    # A policy without constants has none.
    tensors = safetensors.torch.load_file(path) or {"unheard": torch.zeros(2)}
    name = rng.choice(sorted(tensors))
    tensor = tensors[name]
    rows = len(tensor) if tensor.ndim else 0
    first = tensor[: rng.randrange(rows + 1)].clone() if rows else tensor
    odd = tensor.clone()
    if odd.numel():
        values = (-(2**31), -2, -1, 0, rows, 10**6, 2**31 - 1)
        if odd.is_floating_point():
            values = (float("nan"), float("-inf"), 3e38, 6e4, 1e6, -1.5, 1e-30)
        value = torch.tensor(rng.choice(values)).to(odd.dtype)
        odd.view(-1)[rng.randrange(odd.numel())] = value
    ways = {
        "fewer rows": lambda: first,
        "more rows": lambda: torch.cat([tensor, tensor[:1]]) if rows else tensor[None],
        "rows twice": lambda: torch.cat([tensor, tensor]) if rows else tensor,
        "rows in another order": lambda: tensor.flip(0) if rows else tensor,
        "another number": lambda: odd,
        "another sign": lambda: -tensor if tensor.dtype != torch.bool else ~tensor,
        "zeros": lambda: torch.zeros_like(tensor),
        "huge": lambda: (
            torch.full(tensor.shape, rng.choice((1.0, 9e5, 3e38))).to(tensor.dtype)
            if tensor.is_floating_point()
            else tensor
        ),
        "times 1,000": lambda: tensor * 1000 if tensor.dtype != torch.bool else tensor,
        "turned": lambda: tensor.permute(tuple(range(tensor.ndim))[::-1]).contiguous(),
        "flat": lambda: tensor.flatten(),
        "an axis more": lambda: tensor[None].clone(),
        "narrower": lambda: tensor[..., :-1].contiguous() if tensor.ndim else tensor,
        "empty": lambda: tensor.flatten()[:0].clone(),
        "a number": lambda: torch.tensor(1).to(tensor.dtype),
        **{
            str(kind): lambda kind=kind: tensor.to(kind)
            for kind in (
                *(torch.bool, torch.uint8, torch.int16, torch.int32, torch.int64, torch.float16),
                *(torch.float32, torch.float64, torch.bfloat16, torch.float8_e4m3fn),
            )
        },
    }
    way = rng.choice([*ways, "gone", "renamed", "of another", "fewer entities"])
    if way in ways:
        tensors[name] = ways[way]()
    elif way == "gone":
        del tensors[name]
    elif way == "renamed":
        tensors[f"{name}x"] = tensors.pop(name)
    elif way == "of another":
        tensors[name] = tensors[rng.choice(sorted(tensors))].clone()
    else:
        # All arrays of knowledge, cut to the same entities.
        number = rng.randrange(1, 80)
        for one, value in tensors.items():
            if one.endswith(("near_words", "recipes")):
                tensors[one] = value.clamp(max=number - 1)
            if one.endswith(("vectors", "near_words")):
                tensors[one] = tensors[one][:number].clone()
            if one.endswith("num_own") and rng.random() < 0.5:
                tensors[one] = torch.full_like(value, number)
    path.write_bytes(safetensors.torch.save(tensors))
    return f"{name}: {way}"


def use(folder):
    """Open a folder and ask for everything that it can say; the answers fit into JSON."""
    from wordcraft_kg.base.artefacts import json_text

    answers = _ask_policy(folder) if (folder / "policy.json").exists() else _ask_scorer(folder)
    json_text(answers)


def _ask_policy(folder):
    import torch

    from wordcraft_kg import load_policy, open_graph
    from wordcraft_kg.base.errors import GraphMismatchError
    from wordcraft_kg.envs.world import World
    from wordcraft_kg.envs.world_config import WordCraftConfig
    from wordcraft_kg.models.policies.states import Attempts, States

    policy = load_policy(folder)
    entities = policy.entities
    answers = []
    for goal, table, selection in (
        (0, [1, 2, 3, len(entities) - 1, None], None),
        (len(entities) - 1, [4, 5, 6, 7, 8], 5),
        (7, [len(entities) - 1] * 5, len(entities) - 1),
    ):
        for left in (1, 2):
            act = policy.act(goal, table, selection, attempts_left=left)
            answers.append([act.slot, act.entity, act.probability])
        ids = [len(entities) if slot is None else slot for slot in table]
        nothing = len(entities) if selection is None else selection
        state = States(
            *(torch.tensor([goal]), torch.tensor([nothing]), torch.tensor([ids])),
            attempts=Attempts(torch.tensor([2])),
        )
        for source in policy.sources.values():
            answers.append(str(source.evidence(state))[:99])
    world = World(open_graph("kitchen"), WordCraftConfig(num_distractors=3, num_tasks=30))
    policy.bind(world.tasks)
    if policy.graph_hash != world.graph.hash:
        raise GraphMismatchError("another graph, which commands refuse")
    number = torch.arange(len(world.tasks.goals))
    table = (number[:, None] * 7 + torch.arange(5)) % len(entities)
    nothing = torch.full_like(number, len(entities))
    goals = torch.tensor(world.tasks.goals.tolist())
    attempts = Attempts(torch.full_like(number, 2))
    policy(States(goals, nothing, table, number, attempts))
    return answers


def _ask_scorer(folder):
    import torch

    from wordcraft_kg.models.scorers.cross_fitting import CrossFitted
    from wordcraft_kg.models.scorers.recipes import RecipeScorer
    from wordcraft_kg.models.scorers.scorer_folder import load_scorer

    loaded = load_scorer(folder)
    scorers = [loaded]
    if isinstance(loaded, CrossFitted):
        scorers = [loaded.whole, *(loaded.left_out(fold) for fold in range(loaded.count))]
    answers = []
    for scorer in scorers:
        for relation in (0, 1):
            answers += scorer.table(relation).flatten()[:50].tolist()
            answers += scorer.score([0, 1, len(scorer.entities) - 1], relation, [3, 2, 0]).tolist()
        answers += scorer.top(scorer.entities[0], 0, None)
        if isinstance(scorer, RecipeScorer):
            ids = torch.arange(0, len(scorer.entities), 3)
            answers += scorer.score_recipes(ids, ids.flip(0), ids).tolist()
            labels = [scorer.entities[place] for place in (0, -1, -2)]
            supports = scorer.supporting_recipes(*labels)
            answers += [[*one.recipe, one.weight] for one in supports]
            if scorer.proposes_results:
                answers += scorer.candidate_results(ids[:3], ids[:3])[0].tolist()
    if isinstance(loaded, CrossFitted) and loaded.probabilities is not None:
        answers += loaded.probability([0, 1], 1, [2, 3]).tolist()
        if isinstance(loaded.whole, RecipeScorer):
            answers += loaded.result_probabilities([0, 1], [2, 3]).flatten().tolist()
    return answers


def work(home, first, number):
    """Run cases one after another and print a line before each, and what is wrong."""
    import traceback

    from wordcraft_kg.base.errors import WordCraftKGError

    kinds = sorted(path.name for path in Path(home).iterdir() if path.is_dir())
    for case in range(int(first), int(first) + int(number)):
        rng = random.Random(f"folders {case}")
        kind = kinds[case % len(kinds)]
        with tempfile.TemporaryDirectory() as sandbox:
            folder = copied(Path(home), kind, Path(sandbox) / kind)
            what = spoil(folder, rng)
            print(json.dumps([case, kind, what]), flush=True)
            try:
                use(folder)
            except WordCraftKGError:
                print("refused", flush=True)
            except BaseException:
                print(json.dumps(traceback.format_exc(limit=-6)), flush=True)


def problems_of(home, first, number):
    """Return what is wrong with cases, by their numbers, and how many were refused."""
    problems = []
    refused = 0
    end = first + number
    while first < end:
        step = min(BATCH, end - first)
        command = [sys.executable, "-X", "faulthandler", "-c", _WORK, home, first, step]
        ended = subprocess.run(
            [str(part) for part in command], capture_output=True, text=True, check=False
        )
        last = ["none"]
        for line in ended.stdout.splitlines():
            if line.startswith("["):
                last = json.loads(line)
            elif line == "refused":
                refused += 1
            else:
                problems.append(f"folders:{last}: {json.loads(line)}")
        if not ended.returncode:
            first += step
            continue
        shown = ended.stderr.partition("Extension modules")[0][-1500:]
        problems.append(f"folders:{last}: the process ended with {ended.returncode}: {shown}")
        if last == ["none"]:
            break
        first = last[0] + 1
    return problems, refused
