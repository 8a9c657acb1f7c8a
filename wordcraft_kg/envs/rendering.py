"""Pictures for ``render_mode="rgb_array"``, drawn with pygame (extra ``render``).

An environment describes its state as a :class:`Scene`. pygame is imported when the first picture is drawn.
"""

import os
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError, MissingExtraError
from wordcraft_kg.base.extras import pip_install

MODES = ("ansi", "rgb_array")
METADATA: dict[str, Any] = {
    "render_modes": [mode for mode in MODES if mode == "ansi" or find_spec("pygame")],
    "render_fps": 4,
}
"""Metadata for gymnasium, with the render modes that this installation can draw."""
Mark = Literal["plain", "goal", "held", "new", "empty"]
Picture = NDArray[np.uint8]
_Colour = tuple[int, int, int]

_COLUMNS = 6
# In pixels; _HEAD is the height above the table.
TILE, _GAP, MARGIN, _HEAD = (148, 52), 10, 22, 92
_SHARPNESS = 2  # pictures are drawn larger by this factor and scaled down, which smooths all edges

_BACKGROUND, _INK, _FAINT = (250, 249, 246), (38, 40, 46), (134, 136, 142)
# Fill and border of tiles; people with red-green blindness can tell blue from orange.
COLOURS: dict[Mark, tuple[_Colour, _Colour]] = {
    "plain": ((255, 255, 255), (208, 207, 202)),
    "goal": ((255, 236, 204), (222, 139, 18)),
    "held": ((216, 233, 250), (30, 105, 179)),
    "new": ((255, 255, 255), (222, 139, 18)),
    "empty": ((243, 242, 238), (229, 228, 223)),
}


class Tile(NamedTuple):
    """A slot of the table in a picture: the entity's label, a mark for the frame, and the slot's number."""

    label: str
    mark: Mark = "plain"
    number: int | None = None


class Scene(NamedTuple):
    """The content of a picture: facts in a row, each a heading with a tile or a text, and the table.

    The table has rows of ``_COLUMNS`` tiles. All scenes of an environment have equally many tiles.
    """

    facts: Sequence[tuple[str, Tile | str]]
    tiles: Sequence[Tile]


def check_mode(mode: str | None) -> None:
    """Check the name of a render mode.

    Raises:
        ConfigError: for an unknown mode.
        MissingExtraError: if the mode needs pygame, which is missing.
    """
    if mode not in (None, *MODES):
        raise ConfigError(f"`render_mode` {mode!r}: expected None, {', '.join(map(repr, MODES))}.")
    if mode == "rgb_array":
        _pygame()


def rendered(mode: str | None, words: Callable[[], str], scene: Callable[[], Scene]) -> str | Picture | None:
    """Render an environment's state: in words (mode ``ansi``), as a picture (``rgb_array``), or None without a mode."""
    if mode is None:
        return None
    return words() if mode == "ansi" else picture(scene())


def picture(scene: Scene) -> Picture:
    """Draw a scene; return the pixels, shape (height, width, 3), uint8."""
    pygame = _pygame()
    rows = -(-len(scene.tiles) // _COLUMNS)
    width = 2 * MARGIN + _COLUMNS * (TILE[0] + _GAP) - _GAP
    height = 2 * MARGIN + _HEAD + rows * (TILE[1] + _GAP) - _GAP
    canvas = pygame.Surface((width * _SHARPNESS, height * _SHARPNESS), 0, 32)
    canvas.fill(_BACKGROUND)
    for column, (heading, fact) in enumerate(scene.facts):
        left = MARGIN + column * (TILE[0] + _GAP)
        _write(canvas, heading, 15, _FAINT, (left + 2, MARGIN), TILE[0])
        if isinstance(fact, Tile):
            _draw_tile(canvas, fact, left, MARGIN + 22)
        else:
            is_last = column == len(scene.facts) - 1
            _write(canvas, fact, 24, _INK, (left + 2, MARGIN + 40), width - left - MARGIN if is_last else TILE[0])
    for place, tile in enumerate(scene.tiles):
        row, column = divmod(place, _COLUMNS)
        _draw_tile(canvas, tile, MARGIN + column * (TILE[0] + _GAP), MARGIN + _HEAD + row * (TILE[1] + _GAP))
    small = pygame.transform.smoothscale(canvas, (width, height))
    return np.ascontiguousarray(pygame.surfarray.array3d(small).swapaxes(0, 1))


def _draw_tile(canvas: Any, tile: Tile, left: int, top: int) -> None:
    pygame = _pygame()
    fill, border = COLOURS[tile.mark]
    box = pygame.Rect(left * _SHARPNESS, top * _SHARPNESS, TILE[0] * _SHARPNESS, TILE[1] * _SHARPNESS)
    pygame.draw.rect(canvas, fill, box, border_radius=9 * _SHARPNESS)
    thick = 1 if tile.mark in ("plain", "empty") else 2
    pygame.draw.rect(canvas, border, box, width=thick * _SHARPNESS, border_radius=9 * _SHARPNESS)
    if tile.number is not None:
        _write(canvas, str(tile.number), 13, _FAINT, (left + 8, top + 6), 40)
    _write(canvas, tile.label, 21, _INK, (left + TILE[0] / 2, top + TILE[1] / 2), TILE[0] - 24, is_centred=True)


def _write(
    canvas: Any,
    text: str,
    size: int,
    colour: _Colour,
    at: tuple[float, float],
    width: float,
    *,
    is_centred: bool = False,
) -> None:
    drawn = _font(size).render(text, True, colour)
    room = int(width * _SHARPNESS)
    if drawn.get_width() > room:
        drawn = _font(max(11, size * room // drawn.get_width())).render(text, True, colour)
        drawn = drawn.subsurface((0, 0, min(drawn.get_width(), room), drawn.get_height()))
    x, y = at[0] * _SHARPNESS, at[1] * _SHARPNESS
    if is_centred:
        x, y = x - drawn.get_width() / 2, y - drawn.get_height() / 2
    canvas.blit(drawn, (x, y))


def _font(size: int) -> Any:
    font = _pygame().font
    if not font.get_init():
        font.init()
    return font.Font(None, size * _SHARPNESS)


def _pygame() -> Any:
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # else importing it prints a greeting
    try:
        return import_module("pygame")
    except ImportError:
        raise MissingExtraError(
            f"`render_mode` 'rgb_array' needs pygame. Install it: {pip_install('pygame')}"
        ) from None
