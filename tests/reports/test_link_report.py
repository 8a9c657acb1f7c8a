"""The link-prediction report: honest numbers, checks that can fail, and a page that
stands alone."""

import base64
import hashlib
import io
import itertools
import re
from dataclasses import replace

import jsonschema
import msgspec
import numpy as np
import pandas as pd
import pytest
import torch
from helpers import refuses
from report_helpers import Page, link_report, text_of

from wordcraft_kg.base import SplitError, as_values, schema_of
from wordcraft_kg.base.statistics import bootstrap
from wordcraft_kg.evaluation.links import LinkView
from wordcraft_kg.graphs import (
    COMBINES_WITH,
    COMPONENT_OF,
    RELATIONS,
    OpenedGraph,
    Split,
    SplitConfig,
    TrainSample,
    is_in,
    make_split,
    recipe_triples,
)
from wordcraft_kg.models.scorers.baselines import (
    FrequencyScorer,
    NeighbourScorer,
    SymbolicScorer,
    VoteScorer,
)
from wordcraft_kg.models.scorers.factors import TableScorer
from wordcraft_kg.models.scorers.features import glove_features
from wordcraft_kg.models.scorers.near_synonyms import near_synonym_recipes
from wordcraft_kg.models.scorers.ranking import (
    RankingMetrics,
    random_metrics,
    rank_triples,
    ranking_metrics,
)
from wordcraft_kg.reports.pages import render, write_report


def values_of(report):
    return as_values(report.view)


def made(model, **more):
    return link_report(model.scorer, model.opened, **more)


def with_view(report, **changes):
    return replace(report, view=msgspec.structs.replace(report.view, **changes))


@pytest.fixture
def values(kitchen_report):
    """The report's numbers, for a test to break."""
    return values_of(kitchen_report)


@pytest.fixture(autouse=True)
def quick(request, monkeypatch):
    """Leave out most resamples, which take most of the time."""
    if "whole" not in request.fixturenames:
        for place in ("models.scorers.ranking", "evaluation.links"):
            few = lambda *args, **_: bootstrap(*args, resamples=100)  # noqa: E731
            monkeypatch.setattr(f"wordcraft_kg.{place}.bootstrap", few)


@pytest.fixture
def whole():
    """For tests of whole reports."""


@pytest.fixture(scope="module")
def opened(kitchen_model):
    return kitchen_model.opened


@pytest.fixture(scope="module")
def graph(opened):
    return opened.graph


@pytest.fixture(scope="module")
def split(opened):
    return opened.split


@pytest.fixture(scope="module")
def ranks(kitchen_model, graph, split):
    """The ranks of the unseen test triples."""
    return rank_triples(kitchen_model.scorer, split.held_out("test"), graph.triples)


def triple_of(graph, row):
    return graph.id_of(row["head"]), RELATIONS.index(row["relation"]), graph.id_of(row["tail"])


def table_scorer(graph, scores):
    return TableScorer(scores, graph.entities, graph.hash)


def of_frequency(opened):
    return link_report(FrequencyScorer(opened.graph, opened.split.partial), opened)


def checks(values, key="passed"):
    return {check["id"]: check[key] for check in values["checks"]}


def without_ci(metrics):
    """Return metrics without their interval, which holds the MRR and is left out below five
    recipes."""
    low, high = metrics.get("mrr_ci", (0, 1)) if metrics["queries"] < 20 else metrics["mrr_ci"]
    assert low <= metrics["mrr"] <= high
    return {name: value for name, value in metrics.items() if name != "mrr_ci"}


SCHEMA = jsonschema.Draft202012Validator(schema_of(LinkView, "urn:x", "x"))
ALL_PASS = {"leak": True, "mirror": True, "graph": True, "coverage": True}


def test_the_reports_values_are_valid(values, full_report):
    SCHEMA.check_schema(SCHEMA.schema)
    SCHEMA.validate(values)
    SCHEMA.validate(values_of(full_report))


@pytest.mark.parametrize("number", [float("nan"), float("inf"), 1.5, np.float64(0.5), "0.5", None])
def test_a_report_with_a_value_that_its_type_does_not_have_is_not_written(
    kitchen_report, tmp_path, number
):
    broken = with_view(kitchen_report, metrics={"all": RankingMetrics(number)})
    with pytest.raises((ValueError, TypeError)):
        write_report(broken, tmp_path / "report")
    assert list(tmp_path.iterdir()) == []


def test_the_headline_is_the_filtered_ranking_of_unseen_triples(
    values, kitchen_report, kitchen_model, graph, split, ranks
):
    """The headline leaves leaked triples out, and the MRR with them stands beside it."""
    queries = split.held_out("test")
    assert not is_in(queries, split.partial, graph.num_entities).any()
    assert without_ci(values["metrics"]["all"]) == as_values(ranking_metrics(ranks))
    assert (values["triples"], values["queries"]) == (len(queries), 2 * len(queries))
    all_ranks = rank_triples(kitchen_model.scorer, split.triples_of("test"), graph.triples)
    expected = as_values(ranking_metrics(all_ranks))
    assert values["with_leaked"] == pytest.approx(expected, rel=1e-12)
    assert f"MRR would be {expected['mrr']:.3f}" in render(kitchen_report)


def test_the_baselines_are_of_train_and_expected_chance(values, graph, split):
    """The baselines are frequency votes and neighbours in train and expected chance."""
    baselines = {
        "frequency": FrequencyScorer(graph, split.partial),
        "votes": VoteScorer(graph, split.recipes("train")),
        "neighbours": NeighbourScorer(graph, split.partial),
    }
    assert {*values["baselines"]} == {*baselines, "random"}
    for name, scorer in baselines.items():
        ranks = rank_triples(scorer, split.held_out("test"), graph.triples)
        assert without_ci(values["baselines"][name]["all"]) == as_values(ranking_metrics(ranks))
    assert values["baselines"]["random"]["all"] == as_values(random_metrics(ranks))
    assert (
        set(values["baselines"]["frequency"])
        == set(values["baselines"]["random"])
        == set(values["metrics"])
    )


def test_drill_downs_part_the_queries_and_have_intervals(values):
    drill_down = values["drill_down"]
    assert "other_book" not in drill_down  # the model learned from no other book
    assert all(without_ci(row) for rows in drill_down.values() for row in rows.values())
    queries = {
        kind: sum(row["queries"] for row in rows.values()) for kind, rows in drill_down.items()
    }
    assert queries.pop("self_combination") == values["metrics"]["combinesWith"]["queries"]
    assert queries == dict.fromkeys(("seen_in_train", "layer", "near_synonyms"), values["queries"])


def test_the_slices_by_near_synonyms_are_ranked_apart(values, graph, split, ranks):
    recipes = near_synonym_recipes(split, glove_features(graph.entities))
    repeated = {tuple(row) for row in recipe_triples(graph.recipes[recipes]).tolist()}
    mask = np.array(
        [tuple(row) in repeated for row in ranks[["head", "relation", "tail"]].to_numpy().tolist()]
    )
    slices = values["drill_down"]["near_synonyms"]
    for name, part in (
        ("a train recipe with a near-synonym", ranks[mask]),
        ("no such train recipe", ranks[~mask]),
    ):
        assert without_ci(slices[name]) == as_values(ranking_metrics(part))


@pytest.mark.parametrize(("ends", "choose"), [("best", min), ("worst", max)])
def test_best_and_worst_are_the_ends_of_the_ranking_with_each_fact_once(
    values, kitchen_report, ends, choose
):
    def fact(row):
        pair = (row["head"], row["tail"])
        return row["relation"], *(sorted(pair) if row["relation"] == "combinesWith" else pair)

    ranks = {}
    for row in pd.read_csv(io.StringIO(kitchen_report.files["ranks.csv"])).to_dict("records"):
        ranks[fact(row)] = choose(row["rank"], ranks.get(fact(row), row["rank"]))
    expected = sorted(ranks.values(), reverse=ends == "worst")[: len(values[ends])]
    assert [row["rank"] for row in values[ends]] == expected
    assert len({fact(row) for row in values[ends]}) == len(values[ends]) == 8


def test_perhaps_missing_lists_the_best_triples_that_the_graph_lacks(values, kitchen_model, graph):
    known = {tuple(triple) for triple in graph.triples.tolist()}
    table = kitchen_model.scorer.table(COMPONENT_OF)
    pairs = itertools.permutations(range(graph.num_entities), 2)
    missing = sorted(
        (float(table[h, t]) for h, t in pairs if (h, COMPONENT_OF, t) not in known), reverse=True
    )
    listed = [row for row in values["perhaps_missing"] if row["relation"] == "componentOf"]
    assert [row["score"] for row in listed] == pytest.approx(missing[: len(listed)])
    assert not known & {triple_of(graph, row) for row in values["perhaps_missing"]}
    others = [row for row in values["perhaps_missing"] if row["relation"] == "combinesWith"]
    assert len({frozenset((row["head"], row["tail"])) for row in others}) == len(others) > 0


def test_self_edges_are_never_listed_as_missing(opened, graph):
    scores = torch.zeros(2, graph.num_entities, graph.num_entities)
    scores[COMBINES_WITH].fill_diagonal_(1.0)
    scores[COMBINES_WITH, 0, 1] = 2.0
    values = values_of(link_report(table_scorer(graph, scores), opened))
    assert {row["relation"] for row in values["perhaps_missing"]} == set(RELATIONS)
    assert all(row["head"] != row["tail"] for row in values["perhaps_missing"])


def test_a_leaked_test_triple_fails_the_leak_check(kitchen_model, split, monkeypatch):
    honest = split.held_out("test")
    leaked = next(t for t in split.partial.tolist() if t[1] == COMPONENT_OF)
    monkeypatch.setattr(Split, "held_out", lambda self, part: np.concatenate([honest, [leaked]]))
    clusters = "wordcraft_kg.evaluation.ranked_links.triple_groups"
    monkeypatch.setattr(clusters, lambda split, chosen, triples: np.arange(len(triples)))
    report = made(kitchen_model)
    assert checks(values_of(report)) == ALL_PASS | {"leak": False}
    assert checks(values_of(report), "detail")["leak"] == "1 found"


def test_a_mirror_in_train_fails_the_mirror_check(kitchen_model, split, monkeypatch):
    given_away = next(
        t for t in split.held_out("test").tolist() if t[1] == COMBINES_WITH and t[0] != t[2]
    )
    # The mirror is put into train, and the triple itself remains the only one of the two that is
    # evaluated.
    partial = np.concatenate([split.partial, [given_away[::-1]]])
    test = np.array([t for t in split.held_out("test").tolist() if t != given_away[::-1]])
    monkeypatch.setattr(TrainSample, "triples", property(lambda self: partial))
    monkeypatch.setattr(Split, "held_out", lambda self, part: test)
    assert checks(values_of(made(kitchen_model))) == ALL_PASS | {"mirror": False}


def test_a_scorer_of_another_graph_fails_the_graph_check(kitchen_model, opened, graph):
    scores = torch.stack([kitchen_model.scorer.table(relation) for relation in RELATIONS])
    foreign = TableScorer(scores, graph.entities, "0" * 64)
    assert not checks(values_of(link_report(foreign, opened)))["graph"]


@pytest.mark.parametrize(
    "kind",
    [
        "by-recipe",
        pytest.param("by-recipe-plain", marks=pytest.mark.slow),
        pytest.param("by-slot", marks=pytest.mark.slow),
        pytest.param("by-goal", marks=pytest.mark.slow),
    ],
)
def test_a_report_of_every_split_is_valid_and_free_of_leaks(graph, kind):
    split = make_split(graph, SplitConfig(kind=kind, train_ratio=0.5, valid_ratio=0.1))
    report = of_frequency(OpenedGraph(graph, split, kind))
    SCHEMA.validate(values_of(report))
    assert checks(values_of(report))["leak"]
    assert Page(render(report)).faults == []


def test_fewer_than_thirty_unseen_triples_are_an_error(graph):
    """Fewer than thirty unseen triples are an error that suggests another ratio."""
    split = make_split(graph, SplitConfig(train_ratio=0.99))
    assert 0 < len(split.held_out("test")) < 30
    with refuses("train_ratio", SplitError):
        of_frequency(OpenedGraph(graph, split, "few"))


def test_a_graph_without_a_split_has_nothing_to_report_but_memory(graph):
    opened = OpenedGraph(graph, make_split(graph, SplitConfig(kind="none")), "unsplit")
    with pytest.raises(SplitError, match="only 0 unseen"):
        link_report(FrequencyScorer(graph, graph.triples), opened)
    values = values_of(link_report(SymbolicScorer(graph, graph.triples), opened, kg="full"))
    SCHEMA.validate(values)
    assert values["metrics"]["all"]["mrr"] == 1


def test_a_report_of_the_full_graph_is_marked_as_seen(full_report, kitchen_report, graph):
    """A report of the full graph ranks all its triples and is marked as having seen them."""
    values = values_of(full_report)
    assert (values["triples"], values["leaked_left_out"]) == (len(graph.triples), 0)
    assert values["with_leaked"] is None
    assert checks(values) == {"graph": True, "coverage": True}
    for report, has_seen in ((full_report, True), (kitchen_report, False)):
        assert report.view.model.has_seen_the_test_recipes is has_seen
        assert ("Memory, not prediction" in render(report)) is has_seen


@pytest.fixture(scope="module", params=["kitchen_report", "full_report"])
def html(request):
    return render(request.getfixturevalue(request.param))


def test_the_page_is_balanced_and_needs_nothing_from_elsewhere(html):
    page = Page(html)
    assert (page.faults, page.open) == ([], [])
    assert {"html", "head", "title", "body", "table", "svg"} <= set(page.tags)
    assert Page("<p><b>text</p></b>").faults
    assert Page("<div>").open
    loading = {"src", "href", "xlink:href", "srcset", "action", "data", "poster"}
    links = {value for _, name, value in page.attributes if name in loading}
    assert {link for link in links if not link.startswith(("data:", "#"))} == {
        "report.json",
        "ranks.csv",
    }
    assert re.findall(r"url\(|@import", html) == []
    assert not {"link", "iframe", "object", "embed", "base"} & set(page.tags)


def test_the_page_is_complete_without_its_one_script_and_no_other_may_run(html):
    policy = re.search(r'content="(default-src [^"]+)"', html)[1]
    assert "default-src 'none'" in policy
    scripts = re.findall(r"<script>(.*?)</script>", html, re.DOTALL)
    assert len(scripts) == 1
    digest = base64.b64encode(hashlib.sha256(scripts[0].encode()).digest()).decode()
    assert re.search(r"script-src ([^;]+)", policy)[1] == f"'sha256-{digest}'"
    assert not re.search(r"innerHTML|\beval\b|fetch\(|new Function", scripts[0])
    page = Page(html)
    assert [name for _, name, _ in page.attributes if name.startswith("on")] == []
    # All others hold data.
    kinds = [value for tag, name, value in page.attributes if (tag, name) == ("script", "type")]
    assert kinds == ["application/json"] * (page.tags.count("script") - 1)


def test_a_failed_check_is_shown(kitchen_report):
    passed = kitchen_report.view.checks
    for check in passed:
        failed = [msgspec.structs.replace(other, passed=other is not check) for other in passed]
        assert f"FAIL {check.name}" in text_of(
            render(with_view(kitchen_report, checks=tuple(failed)))
        )


def test_a_large_graph_has_a_report_that_says_what_it_leaves_out(
    kitchen_model, kitchen_report, graph, monkeypatch
):
    monkeypatch.setattr("wordcraft_kg.evaluation.ranked_links.MAP_LIMIT", graph.num_entities - 1)
    report = made(kitchen_model)
    assert report.view.without_pairs
    assert set(report.view.baselines) == {"frequency", "random"}
    SCHEMA.validate(values_of(report))
    assert Page(render(report)).faults == []
    note = "this report has no neighbour and vote baselines, and no missing triples"
    assert [note in text_of(render(one)) for one in (kitchen_report, report)] == [False, True]


@pytest.mark.parametrize("max_queries", [-1, 59])
def test_a_sample_too_small_for_a_figure_is_refused(kitchen_model, max_queries):
    with refuses("max_queries"):
        made(kitchen_model, max_queries=max_queries)


def test_the_table_of_ranks_has_a_row_a_query_and_gives_the_headline(
    report_folder, values, graph, split
):
    ranks = pd.read_csv(report_folder / "ranks.csv", keep_default_na=False)
    assert len(ranks) == values["queries"]
    assert (1 / ranks["rank"]).mean() == pytest.approx(values["metrics"]["all"]["mrr"], rel=1e-6)
    for relation in RELATIONS:
        part = ranks[ranks["relation"] == relation]
        assert (1 / part["rank"]).mean() == pytest.approx(
            values["metrics"][relation]["mrr"], rel=1e-6
        )

    named = {
        triple_of(graph, row) for row in ranks[["head", "relation", "tail"]].to_dict("records")
    }
    assert named == {tuple(triple) for triple in split.held_out("test").tolist()}
    assert set(ranks["side"]) == {"head", "tail"}


def test_probabilities_are_compared_with_recipes_outside_train(kitchen_model, values, graph, split):
    """Predicted probabilities are compared with the recipes outside train."""
    known, given = (
        {tuple(row) for row in triples.tolist()} for triples in (split.partial, graph.triples)
    )
    rows, entities = values["probabilities"], range(graph.num_entities)
    expected = list(itertools.product(RELATIONS, ("distinct", "itself")))
    assert [(row["relation"], row["pairs"]) for row in rows] == expected
    for row in rows:
        relation, of_itself = RELATIONS.index(row["relation"]), row["pairs"] == "itself"
        pairs = [
            (head, tail)
            for head in entities
            for tail in (entities if relation else range(head + 1))
        ]
        triples = [(head, relation, tail) for head, tail in pairs if (head == tail) == of_itself]
        triples = [triple for triple in triples if triple not in known]
        chances = kitchen_model.scorer.probability(*torch.tensor(triples).T).double().numpy()
        is_true = np.array([triple in given for triple in triples])
        assert (row["triples"], row["observed"]) == (len(triples), is_true.sum())
        assert row["expected"] == pytest.approx(chances.sum())
        assert row["log_loss"] == pytest.approx(
            -np.log(np.where(is_true, chances, 1 - chances)).mean()
        )
        base = np.where(is_true, row["base_rate"], 1 - row["base_rate"])
        assert row["base_log_loss"] == pytest.approx(-np.log(base).mean())
        assert sum(found["triples"] for found in row["bins"]) == len(triples)
        assert sum(found["triples"] * found["observed"] for found in row["bins"]) == pytest.approx(
            is_true.sum()
        )
        assert all(found["low"] <= found["observed"] <= found["high"] for found in row["bins"])
        means = [found["probability"] for found in row["bins"]]
        assert means == sorted(means)
    assert rows[0]["log_loss"] < rows[0]["base_log_loss"]
