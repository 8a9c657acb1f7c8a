"""Importing general graphs: formats, alignment, tables and triples, and damaged files."""

import gzip
import json

import numpy as np
import pytest
import torch

from wordcraft_kg.base.errors import ArtefactError, ConfigError, KnowledgeFileError
from wordcraft_kg.graphs import OpenedGraph, RecipeGraph, SplitConfig, make_split, open_graph
from wordcraft_kg.graphs.export import export_graph
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.models.knowledge import surroundings
from wordcraft_kg.models.knowledge.importing import import_knowledge
from wordcraft_kg.models.knowledge.knowledge_folder import read_knowledge
from wordcraft_kg.models.knowledge.network import align, plain
from wordcraft_kg.models.knowledge.readers import read_conceptnet, read_triples, read_wordnet
from wordcraft_kg.models.knowledge.score_files import read_scores
from wordcraft_kg.models.knowledge.surroundings import hops, near_triples
from wordcraft_kg.models.policies.sources.registry import make_sources, source_class
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers import score_limits
from wordcraft_kg.models.scorers.factors import SetTableScorer
from wordcraft_kg.models.scorers.scorer_folder import load_scorer

SYNSETS = [
    # offset, field, words, pointers (symbol, offset), gloss
    ("00000001", 3, ["thing"], [], "anything at all"),
    ("00000002", 13, ["food"], [("@", 1)], "a thing to eat"),
    ("00000003", 13, ["bread", "loaf_of_bread"], [("@", 2)], 'food made from dough; "fresh bread"'),
    ("00000004", 13, ["dough"], [("@", 2), ("#s", 3)], "flour and water before baking"),
    ("00000005", 13, ["flour"], [("@", 2), ("#s", 4)], "a powder of ground wheat"),
    ("00000006", 27, ["water"], [("@", 1)], "a clear liquid thing"),
    ("00000007", 21, ["dough", "lolly"], [("@", 1)], "informal terms for money"),
    ("00000008", 13, ["wheat"], [("@", 2)], "grains for making flour"),
]
BOOK = """ingredient_a,ingredient_b,result
flour,water,dough
dough,dough,breads
wheat,wheat,flour
water,water,zzyzx
"""


@pytest.fixture
def wordnet(tmp_path):
    folder = tmp_path / "wordnet"
    folder.mkdir()
    lines = ["  1 the licence\n"]
    senses = {}
    for offset, field, words, pointers, gloss in SYNSETS:
        names = " ".join(f"{word} 0" for word in words)
        links = " ".join(f"{symbol} {target:08d} n 0000" for symbol, target in pointers)
        head = f"{offset} {field:02d} n {len(words):02x} {names} {len(pointers):03d}"
        lines.append(" ".join(filter(None, [head, links])) + f" | {gloss}  \n")
        for word in words:
            senses.setdefault(word, []).append(offset)
    (folder / "data.noun").write_text("".join(lines))
    index = [
        f"{lemma} n {len(some)} 1 @ {len(some)} 0 {' '.join(some)}  \n"
        for lemma, some in sorted(senses.items())
    ]
    (folder / "index.noun").write_text("  1 the licence\n" + "".join(index))
    (folder / "noun.exc").write_text("loaves loaf_of_bread\n")
    for name in ("data.verb", "data.adj", "data.adv"):
        (folder / name).write_text("  1 the licence\n")
    return folder


@pytest.fixture
def opened(tmp_path):
    (tmp_path / "book.csv").write_text(BOOK)
    return open_graph(tmp_path / "book.csv")


@pytest.fixture
def triples(tmp_path):
    path = tmp_path / "mine.tsv"
    path.write_text(
        "head\trelation\ttail\tweight\nflour\tmakes\tdough\t2\ndough\tmakes\tbread\t1\n"
        "mill\tgives\tflour\t1\nmill\tneeds\twheat\t1\n"
    )
    return path


def table_of(folder, name):
    knowledge = read_knowledge(folder)
    (place,) = [place for place, info in enumerate(knowledge.record.tables) if info.name == name]
    entities = knowledge.record.entities
    return lambda row, column: float(
        knowledge.tables[place][entities.index(row), entities.index(column)]
    )


def test_wordnet_becomes_tables_and_triples(run, wordnet, opened, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcome = run("import-knowledge", "book.csv", "--wordnet", "wordnet", "--out", "wn", "--json")
    values = json.loads(outcome.out)
    assert (outcome.code, values["entities"], values["aligned"], values["nodes"]) == (0, 6, 5, 8)
    rows = {
        line.split("\t")[0]: line.split("\t")[1:3]
        for line in (tmp_path / "wn/alignment.tsv").read_text().splitlines()
    }
    # The first sense of dough, not money; breads is the plural of bread.
    assert rows["dough"] == ["wn:00000004-n", "exact"]
    assert rows["breads"] == ["wn:00000003-n", "lemma"]
    assert rows["zzyzx"] == ["", "none"]
    paths, part = table_of(tmp_path / "wn", "paths"), table_of(tmp_path / "wn", "part")
    # The definition of bread names dough.
    assert paths("dough", "breads") > paths("water", "breads")
    assert part("flour", "dough") > part("dough", "flour")
    assert not any(table_of(tmp_path / "wn", name)("zzyzx", "water") for name in values["tables"])
    text = (tmp_path / "wn/triples.tsv").read_text()
    assert "flour\twn:substanceOf\tdough\n" in text
    assert "flour\twn:isA\twn:00000002-n\n" in text
    again = run("import-knowledge", "book.csv", "--wordnet", "wordnet", "--out", "again")
    assert "5 of 6 labels aligned" in again.out
    for name in ("tables.safetensors", "triples.tsv", "alignment.tsv"):
        assert (tmp_path / "wn" / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


def test_overrides_replace_and_leave_out(wordnet, opened, tmp_path):
    (tmp_path / "overrides.tsv").write_text("dough\twn:00000007-n\nwater\t\n")
    import_knowledge(
        opened, "wordnet", wordnet, tmp_path / "wn", overrides=tmp_path / "overrides.tsv"
    )
    rows = {
        line.split("\t")[0]: line.split("\t")[1:3]
        for line in (tmp_path / "wn/alignment.tsv").open()
    }
    assert rows["dough"] == ["wn:00000007-n", "override"]
    assert rows["water"] == ["", "left out"]


def test_each_method_of_alignment(wordnet):
    labels = [
        "breads",
        "dough!",
        "loafofbread",
        "loaves",
        "rye bread",
        "slice of bread",
        "wheatflour",
        "zzyzx",
    ]
    network = read_wordnet(wordnet)
    alignment = align(network, labels)
    assert alignment.methods == (
        "lemma",
        "exact",
        "lemma",
        "lemma",
        "none",
        "none",
        "none",
        "none",
    )
    names = [
        network.nodes[node].lstrip("0") if node >= 0 else "" for node in alignment.nodes.tolist()
    ]
    assert names == ["3-n", "4-n", "3-n", "3-n", "", "", "", ""]
    assert alignment.confidences[[0, 4, 7]].tolist() == [0.95, 0, 0]
    assert 0.5 < alignment.confidences[1] < 1  # dough has two senses


def test_held_out_recipes_have_no_influence(wordnet, tmp_path):
    train = [("flour", "water", "dough"), ("wheat", "wheat", "flour"), ("water", "water", "breads")]
    written = []
    for held_out in (
        [("dough", "dough", "breads")],
        [("breads", "wheat", "water"), ("breads", "breads", "dough")],
    ):
        graph = RecipeGraph.from_recipes([*train, *held_out])
        parts = np.array(
            [2 * (tuple(recipe) in held_out) for recipe in graph.recipe_labels()], dtype=np.int8
        )
        assert parts.sum() == 2 * len(held_out)
        opened = OpenedGraph(graph, Split(graph, SplitConfig(), parts), "")
        out = tmp_path / str(len(held_out))
        import_knowledge(opened, "wordnet", wordnet, out)
        files = [
            (out / name).read_bytes()
            for name in ("tables.safetensors", "triples.tsv", "alignment.tsv")
        ]
        written.append(files)
    assert written[0] == written[1]


def test_large_graphs_are_bounded(triples, opened, monkeypatch):
    network = read_triples(triples)
    alignment = align(network, opened.graph.entities)
    monkeypatch.setattr(surroundings, "MOST_TRIPLES", 2)
    # Edges between entities come first, with the larger weight first.
    assert near_triples(network, alignment, opened.graph.entities) == [
        ("flour", "other:makes", "dough"),
        ("dough", "other:makes", "breads"),
    ]


def test_a_label_like_a_node_and_too_many_entities_are_refused(wordnet, tmp_path, monkeypatch):
    graph = RecipeGraph.from_recipes([("flour", "wn:1", "dough")])
    opened = OpenedGraph(graph, make_split(graph, SplitConfig("none")), "")
    with pytest.raises(KnowledgeFileError, match="'wn:1' looks like the name of a node"):
        import_knowledge(opened, "wordnet", wordnet, tmp_path / "wn")
    graph = RecipeGraph.from_recipes([("flour", "water", "dough")])
    opened = OpenedGraph(graph, make_split(graph, SplitConfig("none")), "")
    monkeypatch.setattr(score_limits, "TABLE_LIMIT", score_limits.table_bytes(2))
    with pytest.raises(ConfigError, match="3 entities"):
        import_knowledge(opened, "wordnet", wordnet, tmp_path / "wn")


def test_one_source_and_a_new_folder_are_needed(
    run, wordnet, opened, triples, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    both = run("import-knowledge", "book.csv", "--wordnet", "wordnet", "--triples", "mine.tsv")
    assert (both.code, both.kind) == (1, "ConfigError")
    assert run("import-knowledge", "book.csv", "--triples", "mine.tsv").code == 0
    again = run("import-knowledge", "book.csv", "--triples", "mine.tsv")
    assert (again.code, again.kind) == (1, "OutputExistsError")
    assert (tmp_path / "knowledge/book-triples/triples.tsv").is_file()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("bred\tx", "line 1: .*bred.* is not a label of the graph.* Did you mean"),
        ("dough", "'dough' is not a label of the graph, a tab"),
        ("dough\twn:1-n", "wn:1-n"),
        (None, r"overrides\.tsv is not a file"),
        ("dough\t\ndough\twn:00000007-n", r"line 2: 'dough' stands in line 1, too"),
    ],
)
def test_wrong_overrides_are_refused(wordnet, opened, tmp_path, line, message):
    if line is not None:
        (tmp_path / "overrides.tsv").write_text(line + "\n")
    with pytest.raises((KnowledgeFileError, ArtefactError), match=message):
        import_knowledge(
            opened, "wordnet", wordnet, tmp_path / "wn", overrides=tmp_path / "overrides.tsv"
        )
    assert not (tmp_path / "wn").exists()


def test_walks_are_those_of_a_slow_reference(triples, opened):
    network = read_triples(triples)
    entities = opened.graph.entities
    alignment = align(network, entities)
    size = len(network.nodes)
    links = np.zeros((size, size))
    for (head, _, tail), weight in zip(
        network.edges.tolist(), network.weights.tolist(), strict=True
    ):
        links[head, tail] += weight
        links[tail, head] += weight
    degrees = np.maximum(links.sum(1), 1e-12)
    steps = links / np.sqrt(degrees[:, None] * degrees)
    own = np.zeros((len(entities), size))
    for entity, node in enumerate(alignment.nodes.tolist()):
        if node >= 0:
            own[entity, node] = alignment.confidences[entity]
    for number, walk in enumerate(hops(network, alignment), 1):
        assert np.allclose(walk, own @ np.linalg.matrix_power(steps, number) @ own.T, atol=1e-6)


def test_triples_have_weights_and_directions(triples, opened, tmp_path):
    view = import_knowledge(opened, "triples", triples, tmp_path / "mine")
    forward = table_of(tmp_path / "mine", "forward")
    assert view.tables == ("paths", "forward")
    assert forward("flour", "dough") > forward("flour", "breads") > 0 == forward("breads", "flour")
    assert "other:mill\tother:gives\tflour\n" in (tmp_path / "mine/triples.tsv").read_text()


def test_conceptnet_keeps_english_words_and_weights(tmp_path):
    def line(relation, start, end, about='{"weight": 2.0}'):
        return "\t".join([f"/a/[{relation},{start},{end}]", relation, start, end, about]) + "\n"

    text = line("/r/IsA", "/c/en/bread/n", "/c/en/food") + line(
        "/r/IsA", "/c/de/brot", "/c/en/food"
    )
    text += line("/r/ExternalURL", "/c/en/bread", "/c/en/x") + line(
        "/r/RelatedTo", "/c/en/food", "/c/en/bread"
    )
    with gzip.open(tmp_path / "cn.csv.gz", "wt") as file:
        file.write(text)
    network = read_conceptnet(tmp_path / "cn.csv.gz")
    assert (list(network.nodes), list(network.relations)) == (
        ["bread", "food"],
        ["IsA", "RelatedTo"],
    )
    assert network.edges.tolist() == [[0, 0, 1], [0, 1, 1]]
    assert network.weights.tolist() == pytest.approx([np.log(3)] * 2)
    for bad in (
        line("/r/IsA", "/c/en/a", "/c/en/b", '{"weight": '),
        line("/r/IsA", "/c/en/a", "/c/en/b", '{"weight": 1e300}'),
        line("/r/IsA", "/c/en/a", "/c/en/b", "{}"),
        line("/r/IsA", "/c/en/a", "/c/en/\udce4"),
        "/a/x\t/r/IsA\t/c/en/a\n",
    ):
        (tmp_path / "bad.csv").write_text(text + bad, errors="surrogateescape")
        with pytest.raises(KnowledgeFileError, match=r"line 5: '/a/.*; expected uri, relation"):
            read_conceptnet(tmp_path / "bad.csv")
    (tmp_path / "bad.csv").write_text(line("/r/IsA", "/c/de/brot", "/c/de/essen"))
    with pytest.raises(KnowledgeFileError, match="has no triple to use"):
        read_conceptnet(tmp_path / "bad.csv")


TABLE = """flour,makes,dough,2
"rye, whole",makes,dough,1
dough,makes,bread,1
"""


@pytest.mark.parametrize(
    "text",
    [
        "head,relation,tail,weight\n" + TABLE,
        ("head,relation,tail,weight\n" + TABLE.replace('"rye, whole"', "rye; whole"))
        .replace(",", "\t")
        .replace("rye;", "rye,"),
        '\ufeffWeight,Tail,Relation,Head\n1,dough,makes,"rye, whole"\n1,bread,makes,dough\n'
        "2,dough,makes,flour\n",
    ],
)
@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_triples_are_read_from_tables_with_tabs_or_commas(put, text, pack):
    path = put(pack(text.encode()), "t.data")
    network = read_triples(path)
    names = {text for text, nodes in network.spellings.items() if nodes}
    edges = {
        tuple(plain(name) for name in (network.nodes[head], network.relations[r], network.nodes[t]))
        for head, r, t in network.edges.tolist()
    }
    assert names == {"flour", "rye, whole", "dough", "bread"}
    assert edges == {
        ("flour", "makes", "dough"),
        ("rye, whole", "makes", "dough"),
        ("dough", "makes", "bread"),
    }


def num_edges(triples):
    heads, _, tails = triples.T
    return int((heads != tails).sum())


def test_an_export_comes_back_with_a_warning_of_held_out_triples(tmp_path, caplog):
    opened = open_graph("kitchen")
    for part in ("full", "partial"):
        export_graph(opened, "tsv", tmp_path / part, part=part)
        view = import_knowledge(opened, "triples", tmp_path / part, tmp_path / f"{part}-knowledge")
        # A general graph has no loops.
        assert view.edges == num_edges(opened.triples(part))
        assert view.held_out == (num_edges(opened.split.unseen) if part == "full" else 0)
    assert ["full holds" in record.message for record in caplog.records] == [True]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "flour,makes,dough\ndough,makes,bread\n",
            "line 1: 'flour,makes,dough'; expected head",
        ),
        ("head,relation,tail,source\nflour,makes,dough,me\n", "line 1: .*below a header"),
        ("tail,relation,head\nflour,makes,dough,1\n", "line 2: .*expected head"),
        ('{"head": "flour"}\n', "line 1: .*expected head"),
        ("h\xe4ad\trelation\ttail\n".encode("latin-1"), "line 1: .*UTF-8"),
        ("head\trelation\ttail\n".encode("utf-16"), "line 1: .*UTF-8"),
        ("head\trelation\ttail\nflour\tmakes\n", "line 2: 'flour\tmakes'; expected"),
        ("head,relation,tail\nflour,,dough\n", "line 2: .*expected head"),
        ("head\trelation\ttail\tweight\nflour\tmakes\tdough\t-1\n", "positive numbers"),
        ("head\trelation\ttail\tweight\nflour\tmakes\tdough\t1e300\n", "positive numbers"),
        ("", "no triple to use"),
        ("head\trelation\ttail\nx\ty\tz\n", "none of the 6 labels"),
        (
            gzip.compress(b"head\trelation\ttail\n" + b"flour\tmakes\tdough\n" * 1000, mtime=0)[
                :60
            ],
            "is damaged: EOFError",
        ),
    ],
)
def test_damaged_or_useless_triples_are_refused(opened, tmp_path, text, message):
    (tmp_path / "t.tsv").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(KnowledgeFileError, match=message):
        import_knowledge(opened, "triples", tmp_path / "t.tsv", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("data.noun", lambda text: text[:-20], "data.noun, line 9: .* not a complete synset"),
        (
            "data.noun",
            lambda text: text.replace("@ 00000002", "@ 00000099", 1),
            "synset 00000099-n does not exist",
        ),
        (
            "index.noun",
            lambda text: text.replace("0 00000008", "0 00000098"),
            "synset 00000098 of 'wheat'",
        ),
        ("index.noun", lambda text: text[:-9], "not a complete entry"),
        (
            "index.noun",
            lambda text: text[: text.index("wheat")],
            "index.noun, no entry for 'wheat'",
        ),
        (
            "data.noun",
            lambda text: text.replace("02 dough 0 lolly 0", "00"),
            "not a complete synset",
        ),
        ("noun.exc", lambda text: "loaves\n", "is not a plural that has a base form"),
        ("noun.exc", lambda text: "\n", "is not a plural that has a base form"),
    ],
)
def test_a_damaged_wordnet_is_refused_with_the_line(wordnet, name, change, message):
    path = wordnet / name
    path.write_text(change(path.read_text() if path.exists() else ""))
    with pytest.raises(KnowledgeFileError, match=message):
        read_wordnet(wordnet)


def test_a_folder_without_wordnet_is_refused(tmp_path):
    with pytest.raises(KnowledgeFileError, match="expected a folder with WordNet's database files"):
        read_wordnet(tmp_path)


@pytest.mark.parametrize("read", [read_triples, read_conceptnet])
@pytest.mark.parametrize("line", [b"\n", b"a\t/r/x\tb\t/c/de/c\t{}\n"])
def test_a_small_file_that_unpacks_to_hours_of_reading_is_refused(tmp_path, read, line):
    start = b""
    if read is read_triples:
        start = b"head\trelation\ttail\tweight\n"
        line = line.replace(b"/c/de/c\t{}", b"1")
    (tmp_path / "t.tsv.gz").write_bytes(gzip.compress(start + line * (2**22 // len(line))))
    with pytest.raises(KnowledgeFileError, match="bytes from a compressed byte"):
        read(tmp_path / "t.tsv.gz")


GRAPH = open_graph("kitchen").graph
ROWS = (("flour", "water", "dough", 9), ("fire", "dough", "bread", 7), ("egg", "egg", "cake", 1))


@pytest.fixture
def file(tmp_path):
    def write(*lines):
        path = tmp_path / "scores.csv"
        path.write_text("\n".join(lines) + "\n")
        return path

    return write


@pytest.fixture
def scorer(file):
    lines = [f"{a} + {b},{result},{score}" for a, b, result, score in ROWS]
    return read_scores(file("set,result,score", *lines), GRAPH)


def test_the_source_is_the_score_of_the_selection_or_of_the_best_partner(scorer):
    (source,) = make_sources(["table"], scorer)
    nothing = GRAPH.num_entities
    flour, water, fire = (GRAPH.id_of(label) for label in ("flour", "water", "fire"))
    table = torch.tensor([[flour, water, fire, nothing]]).expand(3, -1)
    goal = torch.tensor([GRAPH.id_of("dough")] * 3)
    scores = source(States(goal, torch.tensor([nothing, water, fire]), table))
    # 9, 7 and 1 standardised; 0 is their mean.
    high = (9 - 17 / 3) / np.std([9, 7, 1])
    torch.testing.assert_close(
        scores, torch.tensor([[high, high, 0, 0], [high, 0, 0, 0], [0, 0, 0, 0]]).float()
    )
    restored = source_class("t").restored(nothing, source.state_dict())
    assert (restored.keys == source.keys).all()
    with pytest.raises(ValueError, match="ascending"):
        source_class("t").restored(nothing, {"keys": source.keys.flip(0), "values": source.values})


def test_a_triple_has_the_best_score_of_its_sets(scorer):
    assert scorer.score("flour", "componentOf", "dough") == scorer.values.max()
    assert scorer.score("water", "combinesWith", "flour") == scorer.values.max()
    assert scorer.score("egg", "combinesWith", "egg") == scorer.values.min()
    assert scorer.score("flour", "componentOf", "bread") == 0


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ((), "found the columns none"),
        (("set,result",), "found the columns 'set', 'result'"),
        (("set,result,score,score", "flour,dough,1,2"), "'score', 'score'; expected"),
        (("result,score", "dough,1"), "found the columns"),
        (("set,result,score",), "no scores below the header"),
        (("set,result,score", "flour + watr,dough,1"), "line 2: .*'watr'.*water"),
        (("set,result,score", "flour + water,dough,high"), "line 2: .*a finite number"),
        (("set,result,score", "flour + water,dough,nan"), "line 2: .*a finite number"),
        (("set,result,score", "flour + water,dough,1e99"), "line 2: .*a finite number"),
        (("set,result,score", f"flour + water,dough,{'1' * 200_000}"), "line 2: field larger"),
        (("set,result,score", "flour + water,dough"), "line 2: .*a finite number"),
        (("set,result,score", "flour + water,dough,1,2"), "line 2: .*a finite number"),
        (("set,result,score", *["water + flour,dough,1"] * 2), "line 3: .*in an earlier line"),
        (("set,result,score", " + ".join(["egg"] * 9) + ",cake,1"), "1 to 8 ingredients"),
    ],
)
def test_a_faulty_table_is_refused_by_its_line(file, lines, says):
    with pytest.raises(KnowledgeFileError, match=says):
        read_scores(file(*lines), GRAPH)


@pytest.mark.parametrize(
    "tensors",
    [
        {"sets": torch.full((3, 8), 81)},
        {"results": torch.tensor([0, 1, 80])},
        {"values": torch.zeros(2)},
    ],
    ids=str,
)
def test_a_damaged_table_is_refused(file, tensors):
    lines = [f"{a} + {b},{result},{score}" for a, b, result, score in ROWS]
    scorer = read_scores(file("set,result,score", *lines), GRAPH)
    with pytest.raises(ValueError):  # noqa: PT011 - any reason
        SetTableScorer.check(scorer.tensors() | tensors, GRAPH.num_entities)


def test_a_folder_of_scores_serves_players_and_agents(run, refused, file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recipes = [recipe for recipe in GRAPH.recipe_labels() if recipe.result != "bread"]
    lines = [f"{' + '.join(recipe.ingredients)},{recipe.result},5" for recipe in recipes]
    path = file("set,result,score", *lines, "egg + fire,bread,1")
    made = run("import-knowledge", "kitchen", "--scores", path, "--out", "opinions")
    assert (made.code, "train-agent kitchen --scorer opinions --use table" in made.out) == (0, True)
    assert isinstance(load_scorer("opinions"), SetTableScorer)
    few = ("--distractors", 2, "--distractor-seeds", 1)
    (row,) = [
        line
        for line in run("evaluate-agent", "kitchen", "--scorer", "opinions", *few).out.splitlines()
        if line.startswith("opinions, t, best pair")
    ]
    assert float(row.split()[4]) > 0.8
    train = ("train-agent", "kitchen", "--scorer", "opinions", "--steps", 64, "--quiet")
    assert run(*train, "--use", "table", "--out", "agent").code == 0
    assert " t " in run("explain", "agent", "--episodes", 1).out
    both = ("import-knowledge", "kitchen", "--scores", path, "--triples", path)
    refused(*both, says="leave out other knowledge")


def test_other_scorers_have_no_table():
    from wordcraft_kg.models.scorers.baselines import SymbolicScorer

    with pytest.raises(ConfigError, match="import-knowledge --scores"):
        make_sources(["table"], SymbolicScorer(GRAPH, GRAPH.triples))


def test_a_missing_table_is_named(tmp_path):
    with pytest.raises(ArtefactError, match="nowhere"):
        read_scores(tmp_path / "nowhere.csv", GRAPH)
