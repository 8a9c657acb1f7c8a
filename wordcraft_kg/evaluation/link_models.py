"""The models that can be trained to predict links."""

from wordcraft_kg.base.records import Record
from wordcraft_kg.models.links.builders import trainable_models
from wordcraft_kg.models.links.config import ComplExConfig, LinkModelConfig


class LinkModel(Record):
    """A model, and the command that trains it."""

    name: str
    command: str


class LinkModelList(Record):
    """All models: the paper's, then PyKEEN's by name."""

    models: tuple[LinkModel, ...]


def view_link_models() -> LinkModelList:
    """Return the models that can be trained on a recipe graph."""
    names = [kind.__name__ for kind in trainable_models()]
    others = (LinkModel(name, f"{LinkModelConfig.command} --model {name}") for name in names)
    return LinkModelList((LinkModel("ComplEx", ComplExConfig.command), *others))
