import pytest

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.studies.study import built_in, cells_of, parse_study, points_of, read_study

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


def test_points_are_crossed_with_the_grid_and_keep_their_order():
    more = '[[points]]\nsplit = "by-goal"\ntrain_ratio = 0.1\n[[points]]\nsplit = "by-slot"\ntrain_ratio = 0.8'
    study = parse_study(SMALL + more, "x")
    expected = [(*split, amount) for split in (("by-goal", 0.1), ("by-slot", 0.8)) for amount in (2, 1)]
    assert [tuple(point.values()) for point in points_of(study)] == expected
    assert cells_of(study)[0].settings == {"book": "kitchen", "split": "by-goal", "train_ratio": 0.1, "distractors": 2}


@pytest.mark.parametrize(
    ("extra", "said"),
    [
        ('[[points]]\nsplit = "by-goal"\n[[points]]\nbook = "kitchen"', r"points\[1\] has book, points\[0\] has split"),
        ('[[points]]\nsplit = "by-goal"\n[[points]]\nsplit = "by-goal"', r"points\[1\] is a duplicate"),
        ("[[points]]\ndistractors = 3", r"points\[0\].distractors is also in the grid"),
        ('[[points]]\nsplti = "by-goal"', r"unknown setting 'points\[0\].splti'.*split"),
        ('[[points]]\nscorer = "partial"', "variants.guided.scorer is also in the grid"),
        (CLAIM, "needs either 'right', a variant, or 'than'"),
        (CLAIM + 'right = "none"\nthan = 1.0', "needs either 'right', a variant, or 'than'"),
        (CLAIM + 'right = "nnoe"', "names an unknown variant 'nnoe'.*none"),
        (CLAIM + 'right = "none"\nexpected = "comparable"', "how close is comparable"),
        (CLAIM + 'than = 1.0\nmeasure = "steps"', "give 'right'"),
        (CLAIM + 'right = "none"\nat = { distractors = 8 }', "not a grid point"),
        (CLAIM + 'right = "none"\nright_at = { distractors = 8 }', "not a grid point"),
        (CLAIM + 'right = "none"\nexpected = "better"', "Invalid enum value 'better'"),
        (CLAIM + 'right = "none"\nhow = "better"', "unknown field 'how'"),
    ],
)
def test_what_is_wrong_with_points_and_claims_is_named(extra, said):
    with pytest.raises(ConfigError, match=said):
        parse_study(SMALL + extra, "mine.toml")
