"""Rules of conversations; imports nothing heavy, so that the command line can name them."""

from typing import Literal

KnowledgeKind = Literal["none", "partial", "scorer"]
"""What a player may look up: nothing, the train recipes, or what a trained scorer believes."""
REFUSALS = 3
"""How often in a row an answer that is not understood costs nothing; the next one costs the attempt."""
LOOK_UPS = 10
"""How often a player may look something up in a game."""
ATTEMPTS = 100
"""Attempts in a game of the open-ended world."""
TIMEOUT = 60.0
"""Seconds that a program has for an answer."""
