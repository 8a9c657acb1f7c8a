"""Colours of series, for readers with and without full colour vision.

The first six are those of Okabe and Ito 2008, "Color universal design", by their contrast with a white page. The
seventh is the ink of the text; the last one is brown on a white page, and on a dark one their yellow, which white would
swallow. A test simulates deuteranopia and protanopia. Curves differ in dashes too, and dots in shapes.
"""

OKABE_ITO = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
LIGHT = (*OKABE_ITO, "#1b1f24", "#7f3c00")
"""Colours on a white page."""
DARK = (*OKABE_ITO, "#e6edf3", "#f0e442")
"""Colours on a dark page."""
COLOURS = len(LIGHT)
