"""Colours of charts and pages, on a white and on a dark page.

The first six colours of series are from Okabe and Ito 2008, "Color universal design", by contrast
with a white page. The seventh is the text colour; the eighth is brown on a white page and yellow on
a dark page. A test simulates deuteranopia and protanopia. Curves also differ in dashes, and markers
in shape.
"""

OKABE_ITO = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
LIGHT_SERIES = (*OKABE_ITO, "#1b1f24", "#7f3c00")
DARK_SERIES = ("#4d9aff", *OKABE_ITO[1:], "#e6edf3", "#f0e442")
"""Colours on a dark page, where the blue of Okabe and Ito would be too dark for lines."""
COLOURS = len(LIGHT_SERIES)
LIGHT = {
    **{f"s{number}": colour for number, colour in enumerate(LIGHT_SERIES)},
    "ink": "#1b1f24",
    "soft": "#59636e",
    "line": "#d1d9e0",
    "other": "#8c959f",
    "page": "#ffffff",
}
DARK = {
    **{f"s{number}": colour for number, colour in enumerate(DARK_SERIES)},
    "ink": "#e6edf3",
    "soft": "#9da7b1",
    "line": "#3d444d",
    "other": "#6e7681",
    "page": "#0d1117",
}
"""Colours by the names of the style sheet: series, text, quiet text, lines, rest, page."""


def colour_of(number: int) -> str:
    """Return the CSS colour class for a group number.

    Negative numbers and numbers beyond the palette are grey.
    """
    return f"series-{number}" if 0 <= number < COLOURS else "series-other"


def dark_rules() -> str:
    """Return CSS rules that give the elements of class ``chart`` the colours of a dark page.

    A chart has the colours of a white page as attributes, which every program shows; rules of a
    style sheet take precedence over attributes.
    """
    rules = []
    for name, colour in LIGHT.items():
        if DARK[name] == colour:
            continue
        for attribute in ("fill", "stroke"):
            rules.append(f'.chart [{attribute}="{colour}"] {{ {attribute}: {DARK[name]}; }}')
    return "\n".join(rules)
