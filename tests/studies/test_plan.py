from collections import Counter
from functools import partial

import pytest
import small_study
from helpers import refuses

from wordcraft_kg import (
    ComplExConfig,
    ImpalaConfig,
    LinkModelConfig,
    PolicyConfig,
    RecipeScorerConfig,
    SplitConfig,
    TaskConfig,
)
from wordcraft_kg.base.errors import ConfigError, RecipeFileError
from wordcraft_kg.studies.plan import VERSIONS, agent_config, defaults_of, make_plan
from wordcraft_kg.studies.study import (
    adapted,
    built_in,
    cells_of,
    parse_study,
    points_of,
    read_study,
)

TEXT = small_study.TEXT.replace("seed = 0\n", "")
"""A study whose agents have a scorer of their own seed each."""
small_plan = partial(small_study.small_plan, text=TEXT)


def kinds(plan):
    return Counter(task.kind for task in plan.tasks.values())


def test_what_cells_share_is_planned_once_and_before_what_needs_it():
    plan = small_plan()
    assert kinds(plan) == {"graphs": 1, "scorers": 2, "runs": 8}, (
        "a scorer for each seed, for both tables"
    )
    seen = set()
    for address, task in plan.tasks.items():
        assert seen.issuperset(task.needs)
        seen.add(address)


def test_a_scorer_with_a_seed_of_its_own_is_shared_by_all_seeds():
    assert kinds(small_plan(text=TEXT.replace("folds = 3", "folds = 3\nseed = 7")))["scorers"] == 1


def test_equal_trainings_have_one_address_in_all_studies():
    same = '[variants.other]\nscorer = "partial"\nuse = "u,v"\nkg_only = true'
    plan, other = (
        small_plan(same),
        small_plan(same.replace("variants.other", "variants.renamed") + '\nmixing = "free"'),
    )
    assert set(plan.runs) == set(other.runs)
    assert set(plan.runs).isdisjoint(make_plan(adapted(plan.study, steps=1024), "x").runs)
    assert set(plan.runs).isdisjoint(
        make_plan(adapted(plan.study, book="paper-examples"), "x").runs
    )


@pytest.mark.parametrize(
    ("spelled", "short"), [("recipe", "w"), ("plan,combines", "p,u"), ("component", "v")]
)
def test_spelled_sources_have_the_addresses_of_their_letters(spelled, short):
    plans = []
    for use in (spelled, short):
        plans.append(small_plan(f'[variants.other]\nscorer = "partial"\nuse = "{use}"'))
    assert plans[0].runs == plans[1].runs


@pytest.mark.parametrize("scorer", [False, True])
def test_a_file_of_vectors_that_changes_makes_other_trainings(tmp_path, scorer):
    path = tmp_path / "vectors.txt"
    own = f"features = '{path}'"
    more = (
        f"[variants.own]\nscorer = 'own'\n[scorers.own]\ncommand = 'train-recipes'\n{own}"
        if scorer
        else own
    )
    found = []
    for content in ("a 1 2", "a 1 3", "a 1 2"):
        path.write_text(content)
        found.append(set(small_plan(more if scorer else f"[variants.own]\n{own}").runs))
    assert found[0] == found[2]
    assert len(found[0] & found[1]) == 8, "the runs of the other variants stay"


def test_a_split_counts_for_the_default_book_too():
    text = 'title = "x"\nseeds = 1\n[grid]\nsplit = ["by-recipe", "by-goal"]\n[variants.none]'
    tasks = small_plan(text=text).tasks.values()
    assert [task.settings["split"]["kind"] for task in tasks if task.kind == "graphs"] == [
        "by-recipe",
        "by-goal",
    ]


def test_addresses_do_not_depend_on_the_hash_seed_or_the_machine():
    assert small_plan().runs[0] == "runs/d42522d67a8d0227"


def test_all_variants_come_with_their_first_seed_first():
    seeds = [
        task.settings["settings"].get("seed", 0)
        for task in small_plan().tasks.values()
        if task.kind == "runs"
    ]
    assert seeds == sorted(seeds)


def test_what_a_study_leaves_out_has_the_default_of_the_command():
    text = (
        'title = "x"\nseeds = 1\n[scorers.recipes]\ncommand = "train-recipes"\n[grid]\ndepth = [1, '
        "2]\n"
    )
    text += (
        '[variants."u v"]\nscorer = "recipes"\nscorer_cost = 0.3\n[variants.w]\nscorer = '
        '"recipes"\nuse = "u,v,w"'
    )
    scorer, *runs = (
        task.settings for task in small_plan(text=text).tasks.values() if task.kind != "graphs"
    )
    assert scorer["settings"]["features"] == "minilm"
    costs = [agent_config(run["settings"], "", "").trainer.scorer_cost for run in runs]
    assert costs == [0, None, 0, 0]  # the penalty is for agents with w at depth 1 only


def test_a_study_trains_with_the_papers_preset_unless_it_names_another():
    text = 'title = "x"\nseeds = 1\n[settings]\ndepth = 2\n[scorers.partial]\ncommand = "train-complex"\n'
    same = '\nscorer = "partial"\nunroll = 2\nscale = "ranks"'
    text += f"[variants.old]{same}\n"
    text += f'[variants.ours]{same}\npreset = "recommended"\n'
    text += '[variants.all]\nscorer = "partial"\npreset = "recommended"'
    plan = small_plan(text=text)
    old, ours, every = plan.runs
    assert len({old, ours, every}) == 3
    settings = [plan.tasks[run].settings["settings"] for run in (old, ours, every)]
    assert "unroll" not in settings[0]
    with pytest.raises(ConfigError, match="'old' and 'named' are the same trainings"):
        small_plan(text=f'{text}\n[variants.named]{same}\npreset = "paper"')
    found = [agent_config(each, "", "") for each in settings]
    assert [each.trainer.preset for each in found] == ["paper", "recommended", "recommended"]
    assert [each.trainer.unroll for each in found] == [2, 2, 4]
    assert [each.trainer.learning_rate for each in found] == [0.001, 0.005, 0.005]
    assert [each.policy.scale for each in found] == ["ranks", "ranks", "none"]
    assert [each.policy.sees_attempts for each in found] == [False, True, True]


def test_defaults_are_those_that_addresses_stand_for():
    """An address leaves out what is at its default: where one changes, VERSIONS has
    to change too."""
    assert VERSIONS == {"graphs": 1, "scorers": 1, "runs": 3}
    policy = (
        "attention",
        "glove",
        "mean",
        False,
        300,
        300,
        300,
        128,
        0.3,
        0.5,
        "u,v",
        0,
        False,
        False,
        "free",
        "ranks",
        "observed",
    )
    trainer = (
        "paper",
        3_000_000,
        128,
        2,
        0,
        0.99,
        0.001,
        0.99,
        0.01,
        0.01,
        0.5,
        0.0,
        0.0,
        40.0,
        0,
        0,
        "cpu",
        1,
    )
    expected = {
        TaskConfig: (1, 8, None, "sparse", "use", False),
        PolicyConfig: (*policy, False, "softmax", False),
        ImpalaConfig: (*trainer, 10_000, 100_000, 100_000),
        SplitConfig: ("by-recipe", 0.8, 0.0, 0),
    }
    for kind, values in expected.items():
        assert tuple(defaults_of(kind).values()) == values
    of_scorers = {
        ComplExConfig: {
            "epochs": 50,
            "batch_size": 512,
            "folds": None,
            "dim": 128,
            "learning_rate": 0.2,
            "n3": None,
        },
        LinkModelConfig: {
            "epochs": 50,
            "model": "rotate",
            "dim": 128,
            "learning_rate": 0.01,
            "loop": "slcwa",
        },
        RecipeScorerConfig: {
            "kg": "partial",
            "folds": 5,
            "features": "glove",
            "allow_missing": False,
            "seed": 0,
        },
    }
    for kind, known in of_scorers.items():
        defaults = defaults_of(kind)
        assert known.items() <= defaults.items()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (
            '[variants.odd]\nscorer = "partial"\nuse = "x"',
            "variant 'odd', distractors 2: `use` 'x'",
        ),
        ('[variants.odd]\nkg_only = true', "`kg_only` configures the use of a scorer"),
        ('[variants.odd]\nsplit = "none"', "has no test tasks to compare agents on"),
        ('[variants.odd]\nuse = 3', "`use` 3: expected text"),
        ('[variants.odd]\nunroll = "long"', "`unroll` 'long': expected a whole number"),
        ('[variants.odd]\ntrain_ratio = "most"', "`train_ratio` 'most': expected a number"),
        ('[variants.odd]\nin_sample = 1', "`in_sample` 1: expected true or false"),
        ('[variants.odd]\nplayer = "planner"', "give it a scorer"),
        ('[variants.odd]\nfeatures = "glvoe"', "`features` 'glvoe': expected a file"),
        (
            '[variants.odd]\nscorer = "odd"\n[scorers.odd]\ncommand = "train-links"\nmodel = 3',
            "`model` 3",
        ),
        ('[variants.odd]\nsplit = "by-gaol"', "Did you mean 'by-goal'"),
        (
            '[variants.odd]\nscorer = "partial"\n"scorer.model" = "rotate"',
            "no setting 'scorer.model'",
        ),
        ('[variants.odd]\nplayer = "planner"\nscorer = "partial"', "by a recipe scorer"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_before_anything_starts(more, said):
    with pytest.raises(ConfigError, match="variant 'odd'") as raised:
        small_plan(more)
    assert said in str(raised.value)


def test_each_training_may_have_its_own_split():
    plan = small_plan(text="vary_split = true\n" + TEXT)
    graphs = {}
    for cell, run in zip(plan.cells, plan.runs, strict=True):
        graphs.setdefault(cell.seed, set()).add(plan.tasks[run].needs[0])
    first, second = graphs.values()
    assert (len(first), len(second), len(first | second)) == (1, 1, 2)
    seeds = {plan.tasks[graph].settings["split"]["seed"] for graph in first | second}
    assert seeds == {0, 1}


@pytest.mark.parametrize("values", ["[]", "[2, 1, 2]"])
def test_a_grid_needs_different_values(values):
    with pytest.raises(ConfigError, match="at least one value, and none twice"):
        parse_study(TEXT.replace("[2, 1]", values), "mine.toml")


def test_a_split_seed_beside_a_split_for_each_training_is_refused():
    text = "vary_split = true\n" + TEXT.replace("[settings]", "[settings]\nsplit_seed = 1")
    with pytest.raises(ConfigError, match="'split_seed' is set, but with 'vary_split'"):
        parse_study(text, "mine.toml")


@pytest.mark.parametrize("more", ['policy = "attention"', '"scorer.dim" = 3', "distractors = 8"])
def test_variants_that_differ_in_words_alone_are_refused(more):
    text = 'title = "x"\n[settings]\nbook = "kitchen"\n[variants.plain]\n[variants.same]\n'
    with pytest.raises(ConfigError, match="'plain' and 'same' are the same trainings"):
        small_plan(more, text=text)


@pytest.mark.parametrize("name", ["", "a/b", "../a", ".."])
def test_a_name_that_leads_out_of_its_folder_is_refused(name):
    with pytest.raises(ConfigError, match="cannot be called"):
        small_plan(name=name)


def test_a_book_that_is_not_there_is_refused_before_anything_starts():
    with pytest.raises(RecipeFileError, match="no-such-book"):
        make_plan(adapted(read_study("knowledge"), book="no-such-book"), "x")


def test_a_study_that_varies_the_book_itself_takes_no_other():
    study = parse_study(
        TEXT.replace('book = "kitchen"\n', "").replace("[grid]", '[grid]\nbook = ["kitchen"]'), "x"
    )
    with refuses("book"):
        adapted(study, book="everyday")


def test_all_built_in_studies_can_be_shortened_and_short_variants_stay_short():
    for name in built_in():
        shortened = adapted(read_study(name), steps=300_000)
        assert {cell.settings["steps"] for cell in cells_of(shortened)} <= {300_000, 50_000}


SMALL = """
title = "A comparison"
seeds = 2
reference = "none"
[settings]
book = "kitchen"
[grid]
distractors = [2, 1]
[scorers.partial]
command = "train-complex"
[variants.none]
[variants.guided]
scorer = "partial"
"""
CLAIM = '\n[[claims]]\ntext = "Guided is better."\nleft = "guided"\n'


@pytest.mark.parametrize("name", built_in())
def test_a_built_in_study_is_read_and_says_what_it_compares(name):
    study = read_study(name)
    assert all((study.title, study.about, study.source, study.claims))
    assert len(cells_of(study)) == len(points_of(study)) * len(study.variants) * study.seeds


@pytest.mark.parametrize(
    ("extra", "said"),
    [
        ('[search]\nscorer = ["partial"]', "variants.guided.scorer is also in the grid or search"),
        ('[variants.chance]\nplayer = "dice"', "player` 'dice': expected one of random pair"),
        ('[variants.chance]\nplayer = "random pair"\nunroll = 3', "unroll is for an agent"),
        ('[variants.odd]\nscorer = "patrial"', "Did you mean 'partial'"),
        (CLAIM, "needs either 'right', a variant, or 'than'"),
        (CLAIM + 'right = "none"\nthan = 1.0', "needs either 'right', a variant, or 'than'"),
        (CLAIM + 'right = "nnoe"', "variant` 'nnoe': expected one of.*Did you mean 'none'"),
        (CLAIM + 'right = "none"\nexpected = "comparable"', "how close is comparable"),
        (CLAIM + 'than = 1.0\nmeasure = "steps"', "give 'right'"),
        (CLAIM + 'right = "none"\nat = { distractors = 8 }', "not a grid point"),
        (CLAIM + 'right = "none"\nright_at = { distractors = 8 }', "not a grid point"),
        (CLAIM + 'right = "none"\nexpected = "better"', "Invalid enum value 'better'"),
        (CLAIM + 'right = "none"\nhow = "better"', "unknown field 'how'"),
    ],
)
def test_what_is_wrong_with_variants_and_claims_is_named(extra, said):
    with pytest.raises(ConfigError, match=said):
        parse_study(SMALL + extra, "mine.toml")
