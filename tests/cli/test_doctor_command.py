"""`doctor`: states and remedies for sound, small and damaged installations."""

import json

import pytest


@pytest.fixture
def doctor(run, home):
    def doctor():
        outcome = run("doctor", "--json")
        view = json.loads(outcome.out)
        assert view["passed"] == (outcome.code == 0)
        return outcome.code, {one.pop("check"): tuple(one.values()) for one in view["findings"]}

    return doctor


def test_a_sound_installation_passes_and_a_missing_extra_is_a_note(doctor, uninstalled):
    uninstalled("mcp")
    code, checks = doctor()
    assert (code, checks["packages"][0], checks["torch"][0]) == (0, "ok", "ok")
    assert checks["extra explore"] == ("ok", "installed", "")
    assert checks["extra mcp"] == ("note", "mcp is not installed", "pip install 'mcp<3,>=2.3'")


@pytest.mark.parametrize(
    ("missing", "code", "state"),
    [
        (["torch", "pykeen"], 0, "note"),
        pytest.param(["pykeen"], 1, "error", marks=pytest.mark.slow),
    ],
)
def test_only_a_deliberate_light_installation_passes_without_packages(
    doctor, uninstalled, missing, code, state
):
    uninstalled(*missing)
    actual, checks = doctor()
    assert (actual, checks["packages"][0], "torch" in checks) == (
        code,
        state,
        "torch" not in missing,
    )
    assert checks["packages"][2].endswith("pip install 'pykeen<1.12,>=1.11.1'")


def test_an_old_package_fails(doctor, monkeypatch):
    monkeypatch.setattr(
        "wordcraft_kg.base.extras.version", lambda name: "1.0" if name == "scipy" else "99"
    )
    code, checks = doctor()
    assert code == 1
    assert "scipy has version 1.0, expected >=1.12" in checks["packages"][1]
