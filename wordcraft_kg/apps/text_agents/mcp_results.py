"""What the tools of the MCP server return beside their texts; the descriptions are what language models read."""

from pydantic import BaseModel, ConfigDict, Field


class Position(BaseModel):
    """Where a game stands."""

    model_config = ConfigDict(frozen=True)

    game: str = Field(description="id of the game")
    goal: str | None = Field(description="what is to be made; null if there is no goal")
    things: list[str] = Field(description="what can be combined, in the order of its numbers from 1")
    attempts_left: int = Field(description="attempts left")
    is_over: bool = Field(description="whether the game is over")
    success: bool | None = Field(description="whether the goal was made; null before the end, or if there is no goal")


class Begun(Position):
    """A game that begins."""

    rules: str = Field(description="the rules")


class Combined(Position):
    """What came of an attempt."""

    result: str = Field(description="the attempt in words, such as 'water + earth -> mud'")
    new: list[str] = Field(description="things that can be combined now and could not before")


class Known(Position):
    """What is known in a game."""

    attempts: list[str] = Field(description="the attempts so far, and what came of them")


class Facts(BaseModel):
    """What is known of a thing."""

    model_config = ConfigDict(frozen=True)

    game: str = Field(description="id of the game")
    thing: str = Field(description="the thing")
    facts: list[str] = Field(description="what is known of it, what concerns the game most first")
    look_ups_left: int = Field(description="how often something may still be looked up in this game")
