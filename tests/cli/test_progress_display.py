"""What is shown while a command works: bars on a terminal, plain lines elsewhere, nothing with
--quiet."""

import json
import re
import signal

import pytest

from wordcraft_kg.runs.progress import MIN_BAR, ProgressBar, Stages

METRICS = {"success": 0.9407, "test_success": 0.3175, "steps_per_second": 12_439.0}


@pytest.fixture
def terminal(monkeypatch):
    """Make stderr look like a terminal of some columns; return how to read what was drawn, without
    colours."""
    for name in ("NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)
    for name, value in (("TERM", "xterm"), ("TTY_COMPATIBLE", "1"), ("TTY_INTERACTIVE", "1")):
        monkeypatch.setenv(name, value)

    def frames(text):
        return [
            line
            for line in re.split(r"[\r\n]+", re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text))
            if line.strip()
        ]

    return frames


@pytest.fixture
def at_once(monkeypatch):
    """Show every step, however soon it comes after the last one."""
    monkeypatch.setattr(ProgressBar, "INTERVAL", 0.0)
    monkeypatch.setattr(Stages, "INTERVAL", 0.0)


@pytest.mark.parametrize(("width", "num_figures"), [(80, 1), (120, 3), (200, 3)])
def test_a_training_bar_has_room_and_its_figures_are_whole(
    terminal, capsys, monkeypatch, width, num_figures
):
    monkeypatch.setenv("COLUMNS", str(width))
    with ProgressBar.session():
        progress = ProgressBar("agent", unit="step")
        for done in (9_984, 1_500_000, 3_000_000):
            progress(done, 3_000_000, METRICS)
    last = terminal(capsys.readouterr().err)[-1]
    assert len(last.rstrip()) <= width
    assert len(re.findall("[━╸╺]", last)) >= MIN_BAR
    assert "3.00M/3.00M" in last
    shown = ["success 0.9407", "test success 0.3175", "steps per second 12,439"][:num_figures]
    assert last.rstrip().endswith("left  " + "  ".join(shown))


def test_ctrl_c_is_answered_below_the_bar(run, home, terminal, monkeypatch):
    show = ProgressBar.__call__

    def press(self, done, total, figures):
        show(self, done, total, figures)
        if self.unit == "epoch" and done == 2:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(ProgressBar, "__call__", press)
    outcome = run(
        "train-complex",
        "kitchen",
        "--n3",
        "0.1",
        "--dim",
        "8",
        "--epochs",
        "6",
        "--out",
        home / "model",
    )
    assert outcome.code == 130
    bar, message = terminal(outcome.err)[-2:]
    assert bar.startswith("partial graph")
    assert message.startswith("interrupted; epoch")
    assert outcome.err.rindex("\x1b[?25h") < outcome.err.index("interrupted")


@pytest.mark.parametrize(
    ("command", "stages"),
    [
        (
            ["build-graph", "kitchen", "--out", "{home}/graph"],
            ["reading the book", "writing the graph folder"],
        ),
        (["describe", "kitchen"], ["auditing the graph"]),
        (
            ["export", "kitchen", "--format", "tsv", "--out", "{home}/out.tsv"],
            ["writing the export"],
        ),
        (["check-book", "kitchen"], ["checking the book"]),
        (["describe", "kitchen", "--tasks", "--depth", "2"], ["finding tasks"]),
        (
            ["discover", "kitchen", "--runs", "2", "--attempts", "5"],
            ["playing random: 1 of 2", "playing greedy"],
        ),
        pytest.param(
            ["evaluate-agent", "kitchen"],
            ["playing recipe oracle, 8 distractors: 4 of 5"],
            marks=pytest.mark.slow,
        ),
    ],
    ids=lambda value: value[0],
)
def test_commands_name_their_stages_on_stderr_and_are_silent_with_quiet(
    run, home, at_once, command, stages
):
    command = [part.replace("{home}", str(home)) for part in command]
    force = ["--force"] if "--out" in command else []
    outcome = run(*command, "--json")
    assert outcome.code == 0
    assert outcome.out.count("\n") == 1
    json.loads(outcome.out)
    for stage in stages:
        assert f"\n{stage}" in f"\n{outcome.err}"
    assert run(*command, *force, "--quiet").err == ""
