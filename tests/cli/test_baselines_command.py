import pytest


def test_baselines_prints_a_table_of_players_and_distractors(run):
    outcome = run("evaluate-agent", "kitchen", "--distractors", "1,4", "--draws", "2")
    assert outcome.code == 0
    lines = outcome.out.splitlines()
    assert "1 distractor" in lines[0]
    assert "4 distractors" in lines[0]
    oracle = next(line for line in lines if line.startswith("recipe oracle"))
    assert oracle.count("1.000 [") == 2
    assert lines[-1] == (
        "63 test tasks of depth 1, each with 2 draws of distractors; intervals: 95 %, bootstrap over tasks"
    )


def test_baselines_prints_one_json_object(printed):
    result = printed("evaluate-agent", "kitchen", "--distractors", "2", "--depth", "2", "--draws", "1")
    assert (result["part"], result["depth"], result["draws"]) == ("test", 2, 1)
    assert {row["episodes"] for row in result["rows"]} == {result["tasks"]}
    assert result["intervals"] == "95 %, bootstrap over tasks"
    assert {row["distractors"] for row in result["rows"]} == {2}
    assert all(0 <= row["low"] <= row["success"] <= row["high"] <= 1 for row in result["rows"])
    again = printed("evaluate-agent", "kitchen", "--distractors", "2", "--depth", "2", "--draws", "1")
    assert result == again


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["kitchn"], "Did you mean 'kitchen'"),
        (["kitchen", "--distractors", "x"], "--distractors 'x': expected whole numbers, such as 1,2,8."),
        (["kitchen", "--distractors", ""], "--distractors '': expected whole numbers, such as 1,2,8."),
        (["kitchen", "--seed", "-1"], "--seed -1: expected a whole number, 0 or more."),
        (["kitchen", "--distractors", "-1"], "--distractors -1: expected a whole number, 0 or more."),
        (["kitchen", "--distractors", "80"], "--distractors 80: kitchen has 80 entities"),
        (["kitchen", "--depth", "0"], "--depth 0: expected a whole number, 1 to 5."),
        (["kitchen", "--draws", "0"], "--draws 0: expected a whole number, 1 or more."),
        (["kitchen", "--part", "valid"], "kitchen has no task of depth 1 in the valid part"),
        (["kitchen", "--scorer", "nowhere"], "nowhere"),
    ],
)
def test_baselines_refuses_bad_input(refused, arguments, says):
    refused("evaluate-agent", *arguments, says=says)
