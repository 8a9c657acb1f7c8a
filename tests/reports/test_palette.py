"""The colours of series are told apart by readers with and without full colour vision, on light and dark pages."""

import itertools

import numpy as np
import pytest

from wordcraft_kg.reports.charts.plot import COLOURS, DARK, LIGHT

# Machado, Oliveira and Fernandes 2009, "A physiologically-based model for simulation of color vision deficiency",
# severity 1; on linear RGB.
VISION = {
    "full": np.eye(3),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
}
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
DISTANCE = 16.0
"""Least distance of two series in CIELAB; about 2 is just noticeable side by side."""


def linear(colour):
    channels = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    return np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)


def lab(light):
    xyz = TO_XYZ @ np.clip(light, 0, 1) / [0.95047, 1, 1.08883]
    x, y, z = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def distance(vision, one, other):
    return float(np.linalg.norm(lab(VISION[vision] @ linear(one)) - lab(VISION[vision] @ linear(other))))


def contrast(one, other):
    low, high = sorted(float(TO_XYZ[1] @ linear(colour)) for colour in (one, other))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("palette", [LIGHT, DARK], ids=["light", "dark"])
def test_all_pairs_of_series_are_told_apart(palette, vision):
    assert len(palette) == COLOURS
    for one, other in itertools.combinations(palette, 2):
        assert distance(vision, one, other) > DISTANCE, (one, other)


@pytest.mark.parametrize(
    ("palette", "page", "least", "of_first"), [(LIGHT, "#ffffff", 2.2, 3), (DARK, "#0d1117", 4.5, 4.5)]
)
def test_all_series_stand_out_from_the_page_and_the_first_four_clearly(palette, page, least, of_first):
    assert all(contrast(colour, page) > least for colour in palette)
    assert all(contrast(colour, page) > of_first for colour in palette[:4])
