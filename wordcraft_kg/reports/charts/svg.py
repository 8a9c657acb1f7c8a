"""Elements of SVG as text, in which every text and attribute is escaped."""

from markupsafe import Markup

from wordcraft_kg.base.escaping import for_html


def element(name: str, /, *inside: object, **attributes: object) -> Markup:
    """Return an element of SVG.

    Args:
        name: name of the element.
        inside: texts and elements in it; texts are escaped, elements (Markup) are not. Without
            any, the element is a single tag.
        attributes: values by name, in the order of the tag. A name's underscores stand for
            hyphens, and the one in ``class_`` for nothing.

    Example:
        >>> print(element("text", "a < b", text_anchor="end", class_="small"))
        <text text-anchor="end" class="small">a &lt; b</text>
    """
    opening = "<" + name
    for key, value in attributes.items():
        written = key.rstrip("_").replace("_", "-")
        opening += f' {written}="{for_html(value)}"'
    if not inside:
        return Markup(opening + "/>")
    content = "".join(map(for_html, inside))
    return Markup(f"{opening}>{content}</{name}>")


def titled(title: str) -> Markup:
    """Return a tooltip, the element ``title``; nothing for an empty title."""
    return element("title", title) if title else Markup()
