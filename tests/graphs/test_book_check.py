import json
from collections import Counter
from dataclasses import replace

import graph_oracles as oracles
import pytest
from graph_strategies import books, configs, splittable_graphs
from hypothesis import given, strategies as st
from test_splits import HELD_OUT_KINDS, drawn

from wordcraft_kg.base.records import as_values
from wordcraft_kg.graphs import (
    RecipeBook,
    RecipeGraph,
    SplitConfig,
    audit,
    make_split,
    open_book,
    read_book,
    write_book,
)
from wordcraft_kg.graphs.audit import SHOWN, one_ingredient_away
from wordcraft_kg.graphs.book_check import check_book
from wordcraft_kg.graphs.library import locate_book

HEADER = "ingredient_a,ingredient_b,result\n"


@pytest.fixture
def check(put):
    def check(text, name="book.csv", **options):
        path = put(text, name)
        data = path.read_bytes()
        checked = check_book(path, **options)
        assert path.read_bytes() == data
        return checked

    return check


def kinds(checked):
    return [(finding.kind, finding.severity, finding.lines) for finding in checked.findings]


def problems(checked):
    return [
        (finding.kind, finding.lines)
        for finding in checked.findings
        if finding.severity == "problem"
    ]


def messages(checked, kind):
    return [finding.message for finding in checked.findings if finding.kind == kind]


def message(checked, kind):
    (text,) = messages(checked, kind)
    return text


def test_everything_wrong_is_reported_in_one_run_with_its_lines(check):
    text = (
        "\ufeff# base: water, earth\n"  # 1: byte order mark
        "ingredient_a,ingredient_b,result\n"
        "water,earth,mud\r\n"  # 3: CRLF
        "earth,water,mud\n"  # 4: listed twice
        '"salt, white",water,brine\n'  # 5: a comma; salt cannot be made
        "Mud,water,swamp\n"  # 6: a label in two spellings, and so out of reach
        "egg,earth,hen\n"  # 7: a circle
        "hen,water,egg\n"  # 8
        "water,earth\n"  # 9: no result
        "mud,water,mud\n"  # 10: makes itself
        "mud,  ,clay\n"  # 11: one ingredient
        'mud,"water,clay\n'  # 12: a quote that never ends
    )
    found = check(text)
    assert not found.passed
    assert problems(found) == [
        ("duplicate", (3, 4)),
        ("spelling", (3, 6)),
        ("comma", (5,)),
        ("unreachable", (5, 6, 7)),
        ("row", (9,)),
        ("self-result", (10,)),
        ("label", (11,)),
        ("row", (12,)),
    ]
    assert message(found, "duplicate") == "earth + water -> mud is listed 2 times"
    assert (
        message(found, "spelling")
        == "'Mud' and 'mud' count as different entities; if they are the same thing, use one spelling"
    )
    assert (
        message(found, "comma")
        == "the label 'salt, white' contains a comma, at which other tools may split it"
    )


def test_a_clean_book_passes_and_notes_do_not_fail_it(check):
    found = check(
        "# base: water, earth\n" + HEADER + "water,earth,mud\nmud,mud,brick\nbrick,mud,bricks\n"
    )
    assert found.passed
    assert kinds(found) == [("plural", "note", (4, 5))]
    assert message(found, "plural") == "'brick' and 'bricks' are singular and plural of one word"


@pytest.mark.parametrize(
    ("kind", "one", "other", "expected"),
    [
        *[
            ("plural", *pair, True)
            for pair in (("fly", "flies"), ("box", "boxes"), ("glass", "glasses"))
        ],
        ("plural", "gras", "grass", True),
        *[
            ("plural", *pair, False)
            for pair in (("fly", "flown"), ("bus", "busy"), ("sea", "seas ide"))
        ],
        # Case, blanks and composition.
        *[
            ("spelling", *pair, True)
            for pair in (("ice cream", "ice-cream"), ("Mud", "mud"), ("café", "cafe\u0301"))
        ],
        *[("spelling", *pair, False) for pair in (("c", "c++"), ("कम", "काम"))],
    ],
)
def test_labels_that_are_alike_are_found(check, kind, one, other, expected):
    found = check(f"{HEADER}{one},{one},x\n{other},{other},x\n{one},{other},x\n")
    assert (kind in [finding.kind for finding in found.findings]) == expected


@pytest.mark.parametrize("name", ["book.csv", "book.tsv", "book.json"])
@given(book=books())
def test_what_reads_is_checked_as_the_graph_it_makes(tmp_path_factory, name, book):
    path = tmp_path_factory.mktemp("books") / name
    write_book(book, path)
    found = check_book(path)
    read = (
        read_book(path, keep_self_results=False)
        if any(not r.is_self_result for r in book.recipes)
        else None
    )
    if read is None:
        assert found.graph is None
        assert not found.passed
    else:
        assert found.graph == RecipeGraph.from_book(read)
        assert not {"row", "label", "header", "directive", "bom", "line-ends"} & {
            f.kind for f in found.findings
        }
        assert ("self-result" in {f.kind for f in found.findings}) == (
            read.dropped_self_results > 0
        )


def test_the_base_may_be_given(check):
    text = HEADER + "a,b,c\nb,c,a\n"
    assert check(text, base=["a", "b"]).passed
    (finding, *_) = check(text, base=["q"]).findings
    assert (finding.kind, finding.severity) == ("base", "problem")
    assert finding.message == "base entities that are not in book: q"
    misspelt = check("# a book\n# base: water, fier\n" + HEADER + "water,fire,steam\n")
    assert ("base", (2,)) in problems(misspelt)
    assert message(misspelt, "base").startswith(
        "the base entity 'fier' is in no recipe. Did you mean 'fire'?"
    )
    assert misspelt.graph.base == ("water",)


MESSAGES = {
    "base": (
        "# base: a, idle\n# entities: idle\n" + HEADER + "a,a,b\n",
        "base entities that no recipe uses: idle",
    ),
    "idle": ("# base: a\n# entities: z\n" + HEADER + "a,a,b\n", "listed, but in no recipe: z"),
    "duplicate": (
        HEADER.replace(",", ", ") + "a, b, c\na,b,c\n",
        "a + b -> c is listed 2 times",
    ),  # cells as read
    "header": (
        HEADER + "a,a,b\n" + HEADER,
        "'ingredient_a, ingredient_b, result' names the columns again; keep one table.",
    ),
    "directive": (
        "# base: a, \t\n" + HEADER + "a,a,b\n",
        "the label '' is blank; every entity needs a name.",
    ),
}


@pytest.mark.parametrize("kind", MESSAGES)
def test_a_finding_says_what_is_wrong(check, kind):
    text, expected = MESSAGES[kind]
    found = check(text)
    assert message(found, kind) == expected
    assert found.passed == (kind == "idle")
    assert found.figures.recipes == 1


def test_single_ingredients_are_read_as_asked_or_a_problem(check):
    """A check reads single ingredients as asked and is a problem otherwise."""
    text = HEADER + "sand,,glass\n"
    assert "'sand' is the only ingredient" in message(check(text), "label")
    assert message(check(HEADER + "milk,, \n"), "row") == "1 row without ingredients or result"
    assert check(text, single_ingredient="self").graph.recipe_labels() == [
        ("sand", "sand", "glass")
    ]
    assert check(text, single_ingredient="oven").graph.recipe_labels() == [
        ("oven", "sand", "glass")
    ]


@pytest.mark.parametrize("text", ["", HEADER, HEADER + "a,b\n", "# only a comment\n"])
def test_a_book_without_recipes_fails_and_has_no_figures(check, text):
    found = check(text)
    assert not found.passed
    assert (found.graph, found.figures) == (None, None)


def test_a_json_book_reports_its_first_error_or_its_counts(check):
    broken = check("{", "book.json")
    assert kinds(broken) == [("unreadable", "problem", ())]
    rows = [["a", "b", "c"], ["b", "a", "c"], ["a", "b", "a"]]
    text = json.dumps({"entities": ["a", "b", "c"], "base": ["a", "b"], "recipes": rows})
    found = check(text, "book.json")
    problems = [finding.message for finding in found.findings if finding.severity == "problem"]
    assert problems == [
        "a + b -> c is listed 2 times: recipes[0], recipes[1]",
        "'a' is made from itself; such rows are dropped",
    ]


JSON = json.dumps({"entities": ["a", "b, c"], "base": ["a"], "recipes": [["a", "a", "b, c"]]})
LINE = "# base: a, b\n" + HEADER + "a,b,c\na,b\n"


BYTES = {
    "not UTF-8": (
        HEADER.encode() + b"caf\xe9,a,b\na,b\n",
        "book.csv",
        [("unreadable", ())],
    ),
    "UTF-16": (
        (HEADER + "café,a,b\na,b\n").encode("utf-16"),
        "book.csv",
        [("encoding", ()), ("row", (3,))],
    ),
    "CR": (LINE.replace("\n", "\r"), "book.csv", [("row", (4,))]),
    "CRLF": (LINE.replace("\n", "\r\n"), "book.csv", [("row", (4,))]),
    "JSON": (
        "\ufeff" + JSON.replace(",", ",\r\n", 1),
        "book.json",
        [("comma", ())],
    ),
}


@pytest.mark.parametrize(("data", "name", "expected"), BYTES.values(), ids=BYTES)
def test_a_file_is_looked_at_byte_by_byte(check, data, name, expected):
    assert problems(check(data, name)) == expected


LINES = [
    *("a,b,c", "a,a,b", "a,a,a", "c,b,a", "", " ", "a,b", "a,b,c,d", "x,x,y", HEADER.strip()),
    *('"a",b,c', 'a,"b,c', "#,a,b"),
]


@given(
    lines=st.lists(st.sampled_from(LINES), max_size=6),
    head=st.sampled_from(["", HEADER, '"ingredient_a",b,c\n']),
)
def test_what_passes_can_be_read(tmp_path_factory, lines, head):
    path = tmp_path_factory.mktemp("books") / "book.csv"
    path.write_text("# base: a\n" + head + "\n".join(lines), encoding="utf-8")
    found = check_book(path)
    if found.passed:
        assert RecipeGraph.from_book(read_book(path)) == found.graph


def test_the_figures_count_the_book(check):
    text = "# base: a, b\n" + HEADER + "a,b,c\na,b,d\na,a,c\nc,d,e\na,e,f\n"
    figures = check(text).figures
    assert (figures.entities, figures.recipes, figures.pairs) == (6, 5, 4)
    assert figures.base == ("a", "b")
    assert (figures.reachability.reachable, figures.reachability.rounds) == (6, 3)
    assert figures.degrees.recipes_per_craftable.mean == 5 / 4
    assert (figures.degrees.terminal, figures.degrees.self_pairs) == (1, 1)
    assert figures.degrees.most_used[0] == ("a", 4)
    assert figures.ambiguity.pairs_by_number_of_results == {"1": 3, "2": 1}


def test_everyday_has_the_size_and_the_shape_it_was_written_for():
    found = check_book(locate_book("everyday").path)
    assert found.passed
    figures = found.figures
    assert set(figures.base) == {"air", "earth", "fire", "time", "water"}
    assert figures.entities == figures.reachability.reachable
    assert set(figures.ambiguity.pairs_by_number_of_results) <= {"1", "2", "3"}
    # As documented; a change to the book changes its datasheet, README, docs/books.md and
    # CHANGELOG too.
    assert (figures.entities, figures.recipes, figures.pairs) == (1_177, 6_510, 6_313)
    assert (figures.degrees.terminal, figures.degrees.self_pairs) == (98, 122)
    assert figures.reachability.rounds == 16
    assert figures.degrees.most_used[0][1] / figures.recipes == pytest.approx(0.0223, abs=5e-5)
    assert found.graph.recipe_counts[found.graph.recipe_counts > 0].min() == 2


def test_version_1_of_everyday_stays():
    assert RecipeGraph.from_book(open_book("everyday-1")).hash.startswith(
        "917cafc4ad2040cee7b8bef270ef37db"
    )


def test_long_lists_are_cut_and_equal_faults_are_one(check):
    """Long lists are cut short, and faults of one cause are one finding."""
    (duplicate,) = (
        finding
        for finding in check(HEADER + "a,a,b\n" * 40).findings
        if finding.kind == "duplicate"
    )
    assert len(duplicate.lines) == 15
    assert duplicate.message.endswith("listed 40 times")
    rows = "".join(f"no,recipe,in,row {i}\n" for i in range(100))
    found = check(HEADER + rows + "a,b\n" + "a,a,b\n")
    one, two = (finding for finding in found.findings if finding.kind == "row")
    assert one.lines == tuple(range(2, 17))
    assert one.message.startswith("'no,recipe,in,row 0' has 4 cells; the table has 3 columns")
    assert one.message.endswith("(99 more like this)")
    assert two.lines == (102,)


def test_a_book_without_any_entity_to_begin_with_says_that_it_has_no_base(check):
    findings = check(HEADER + "a,b,c\nb,c,a\na,c,b\n").findings
    assert [finding.kind for finding in findings] == ["unreachable"]
    assert "no base can be inferred" in findings[0].message


MESSY = {
    "table": (
        "book.csv",
        """# an author
ingredient_a,ingredient_b,result,note
water,flour,dough,1
flour,water,dough,2
ham + cheese,bread,sandwich,3
bread,bread,bread,4
bread,bread,bread,5
,,alone,6
milk,culture,yogurt,7
a,b,c,d,e
""",
    ),
    "lines": (
        "book.txt",
        "# mine\nwater + flour = dough\nflour + water = dough\nno recipe\na + a = a\n",
    ),
    "json": (
        "book.json",
        '[{"ingredients": ["a", "b"], "result": "c"}, {"ingredients": [], "result": "d"}]',
    ),
}


@pytest.mark.parametrize(("name", "text"), MESSY.values(), ids=MESSY)
def test_each_row_is_a_recipe_or_a_loss_with_its_reason_and_its_place(check, name, text):
    found = check(text, name)
    left_out = found.reading.left_out
    assert found.reading.kept == found.figures.recipes == len(found.book.recipes)
    assert found.reading.rows == found.reading.kept + sum(left_out.values())
    assert {reason: len(places) for reason, places in found.lost.items()} == left_out
    if name == "book.csv":
        assert found.reading.rows == 8
        assert left_out["with a problem"] == 2
        assert found.lost["with a problem"] == [5, 10]
        assert found.lost["with an ingredient as the result"] == [6, 7]
        assert "ingredient_a,ingredient_b,ingredient_c,result" in message(found, "label")


def test_a_sum_that_our_own_table_takes_for_a_label_names_the_third_column(check):
    found = check(HEADER + "ham + cheese,bread,sandwich\n")
    assert "ingredient_a,ingredient_b,ingredient_c,result" in message(found, "several")


def audited(graph):
    return as_values(audit(graph, make_split(graph, SplitConfig("none"))))


def test_the_audit_counts_and_names_everything():
    rows = [
        *[("a", "a", "b"), ("a", "b", "c"), ("a", "b", "d"), ("b", "b", "D"), ("c", "d", "e")],
        *[("lost", "c", "found"), ("found", "a", "lost")],
    ]
    book = RecipeBook.of("book", rows, base=["a"], listed=["idle"], keep_self_results=True)
    values = audited(RecipeGraph.from_book(book))
    assert (values["entities"], values["recipes"], values["pairs"], values["base"]) == (
        9,
        7,
        6,
        ["a"],
    )
    assert values["triples"] == {"combinesWith": 10, "componentOf": 12, "total": 22}
    assert values["ambiguity"] == {
        "pairs_by_number_of_results": {"1": 5, "2": 1},
        "pairs_with_several_results": 1,
        "examples": [{"pair": ["a", "b"], "results": ["c", "d"]}],
    }
    assert values["reachability"] == {
        **{"reachable": 6, "rounds": 3, "known_after_round": [1, 2, 5, 6]},
        **{"unreachable": 3, "unreachable_entities": ["found", "idle", "lost"]},
    }
    degrees = values["degrees"]
    assert (degrees["craftable"], degrees["terminal"], degrees["idle"], degrees["self_pairs"]) == (
        7,
        2,
        1,
        2,
    )
    assert degrees["recipes_per_craftable"] == {"mean": 1.0, "median": 1.0, "max": 1}
    assert degrees["most_used"][:2] == [["a", 4], ["b", 3]]
    assert values["labels"] == {"alike": 1, "alike_labels": [["D", "d"]]}


def test_lists_of_the_audit_are_cut_but_counts_are_complete():
    rows = [("a", "b", f"made {i}") for i in range(50)] + [
        ("lost", f"lost {i}", "end") for i in range(50)
    ]
    reachability = audited(RecipeGraph.from_recipes(rows, base=["a", "b"]))["reachability"]
    assert (reachability["unreachable"], len(reachability["unreachable_entities"])) == (52, SHOWN)
    empty = audited(RecipeGraph(["a"], [], []))
    counts = (
        empty["recipes"],
        empty["pairs"],
        empty["triples"]["total"],
        empty["reachability"]["rounds"],
    )
    assert counts == (0, 0, 0, 0)


@pytest.mark.parametrize("kind", HELD_OUT_KINDS)
@given(graph=splittable_graphs(), config=configs("by-recipe"))
def test_nearness_to_train_equals_counts_over_labels(kind, graph, config):
    split = drawn(graph, replace(config, kind=kind))
    train, test = (graph.recipe_labels(split.recipes(part)) for part in ("train", "test"))
    made = {result for *_, result in train}
    sizes = as_values(audit(graph, split))["split"]
    assert sizes["test_goals"] == len({result for *_, result in test})
    assert sizes["test_goals_in_train"] == len({result for *_, result in test} & made)
    near = [
        any(r.result == known.result and {*r[:2]} & {*known[:2]} for known in train) for r in test
    ]
    assert sizes["one_ingredient_away"] == sum(near)
    assert one_ingredient_away(split).tolist() == near
    if kind in ("by-slot", "by-goal"):
        assert not any(near)


@pytest.mark.parametrize("kind", HELD_OUT_KINDS)
@given(graph=splittable_graphs(), config=configs("by-recipe"))
def test_leakage_counts_equal_sets_of_triples(kind, graph, config):
    split = drawn(graph, replace(config, kind=kind))
    of = {
        part: oracles.triples(graph.recipe_labels(split.recipes(part)))
        for part in ("train", "valid", "test")
    }
    evaluated = of["test"] - of["train"] - of["valid"]
    result = as_values(audit(graph, split))
    assert result["split"]["evaluated_triples"] == len(evaluated)
    assert result["split"]["leaked_triples"] == len(of["test"]) - len(evaluated)
    for relation, row in result["leakage"].items():
        train, test, left = (
            Counter(r for _, r, _ in part)[relation]
            for part in (of["train"], of["test"], evaluated)
        )
        mirrored = sum(r == relation and (t, r, h) in of["train"] for h, r, t in evaluated)
        counts = {
            "train": train,
            "from_test_recipes": test,
            "already_in_train": test - left,
            "evaluated": left,
        }
        assert row == counts | {"mirror_in_train": mirrored}
    assert result["leakage"]["combinesWith"]["mirror_in_train"] == 0
