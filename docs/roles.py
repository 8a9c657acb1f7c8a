"""An extension for the Python reference: docstrings as mkdocstrings wants them."""

import re

import griffe


class Roles(griffe.Extension):
    """Makes roles plain code, the double colon before a literal block a single one, and Example the
    name it knows. Headings rise by a level: mkdocstrings puts them two below an object's.
    """

    def on_object(self, *, obj: griffe.Object, **kwargs: object) -> None:
        """Rewrite the docstring of an object."""
        if obj.docstring:
            text = re.sub(r":[a-z]+:`~(?:[\w.]+\.)?(\w+)`", r"`\1`", obj.docstring.value)
            text = re.sub(r":[a-z]+:`([\w.]+)`", r"`\1`", text)
            text = re.sub(r"^( *)Example:$", r"\1Examples:", text, flags=re.MULTILINE)
            text = re.sub(r"^##(?= )", "#", text, flags=re.MULTILINE)
            obj.docstring.value = re.sub(r"::$", ":", text, flags=re.MULTILINE)
