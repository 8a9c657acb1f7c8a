"""A trained model of the kitchen and its report, made once a session."""

import pytest
from report_helpers import link_report

from wordcraft_kg.models.model_folder import open_model
from wordcraft_kg.reports.pages import write_report


@pytest.fixture(scope="session")
def kitchen_model(made_once):
    from wordcraft_kg.models.links.link_config import ComplExConfig, LinksConfig
    from wordcraft_kg.models.links.link_training import train_links

    config = LinksConfig("kitchen", ComplExConfig(dim=8, epochs=6, n3=0.1))
    return open_model(made_once("reported/kitchen", lambda out: train_links(config, out)))


@pytest.fixture(scope="session")
def kitchen_report(kitchen_model):
    """Shared by the tests."""
    return link_report(
        kitchen_model.scorer,
        kitchen_model.opened,
        name="kitchen",
        provenance=kitchen_model.provenance,
    )


@pytest.fixture(scope="session")
def report_folder(kitchen_report, tmp_path_factory):
    folder = tmp_path_factory.mktemp("reports") / "kitchen"
    write_report(kitchen_report, folder)
    return folder


@pytest.fixture(scope="session")
def full_report(kitchen_model):
    return link_report(kitchen_model.scorer, kitchen_model.opened, kg="full", name="kitchen-full")
