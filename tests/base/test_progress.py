from contextlib import suppress

from wordcraft_kg.base.progress import listening, stage, steps


def test_a_listener_hears_each_step_from_none_to_all():
    heard = []
    with listening(lambda *said: heard.append(said)):
        assert list(steps("ranking", "ab")) == ["a", "b"]
    assert heard == [("ranking", 0, 2), ("ranking", 1, 2), ("ranking", 2, 2)]


def test_without_a_listener_steps_are_just_their_items():
    heard = []
    with listening(lambda *said: heard.append(said)), listening(None):
        assert list(steps("ranking", [1, 2])) == [1, 2]
    assert list(steps("ranking", [1, 2])) == [1, 2]
    assert heard == []


def test_a_stage_that_is_given_up_ends_all_the_same():
    heard = []

    def give_up():
        for _ in steps("outer", range(9)):
            raise ValueError

    with listening(lambda *said: heard.append(said)):
        with suppress(ValueError):
            give_up()
        for _ in steps("broken off", range(9)):
            break
    assert heard == [("outer", 0, 9), ("outer", 9, 9), ("broken off", 0, 9), ("broken off", 9, 9)]


def test_a_function_can_be_a_stage_and_is_one_at_each_call():
    @stage("drawing")
    def draw(number):
        return number + 1

    heard = []
    with listening(lambda *said: heard.append(said)):
        assert [draw(1), draw(2)] == [2, 3]
    assert heard == [("drawing", 0, 1), ("drawing", 1, 1)] * 2
