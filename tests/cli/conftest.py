"""Commands that are expected to print values, or to be refused."""

import json

import pytest


@pytest.fixture
def printed(run):
    """Run a command that goes well, and return the JSON object that it prints."""

    def printed(*command):
        outcome = run(*command, "--json")
        assert outcome.code == 0, outcome.err
        assert outcome.out.count("\n") == 1
        found = json.loads(outcome.out)
        assert isinstance(found, dict)
        return found

    return printed


@pytest.fixture
def refused(run):
    """Run a command that is refused without a result or a traceback, and return the error."""

    def refused(*command, says=(), kind=None, code=1):
        outcome = run(*command)
        assert (outcome.code, outcome.out) == (code, "")
        assert kind in (None, outcome.kind)
        assert "Traceback" not in outcome.err
        for part in [says] if isinstance(says, str) else says:
            assert part in outcome.err
        return outcome.err

    return refused
