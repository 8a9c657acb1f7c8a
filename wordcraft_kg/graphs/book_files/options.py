"""What a user says about a recipe file, instead of a guess."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypedDict

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import one_of
from wordcraft_kg.graphs.book_files.dialects import delimiter_of
from wordcraft_kg.graphs.book_files.text import check_encoding
from wordcraft_kg.graphs.recipes import check_label

CASES = ("keep", "fold")
INGREDIENTS = ("two", "chain")


class ReadOptions(TypedDict, total=False):
    """The fields of :class:`BookOptions` as keyword arguments.

    Attributes:
        single_ingredient: second ingredient for recipes of one.
        columns: columns of the ingredients and, last, of the result.
        delimiter: column delimiter.
        encoding: encoding of the text.
        case: ``keep`` or ``fold``.
        ingredients: ``two`` or ``chain``.
    """

    single_ingredient: str | None
    columns: Sequence[str] | None
    delimiter: str | None
    encoding: str | None
    case: str
    ingredients: str


@dataclass(frozen=True)
class BookOptions:
    """What a user says about a file, instead of a guess.

    Attributes:
        single_ingredient: second ingredient for recipes of one: ``self`` repeats the ingredient,
            another text names a second one, such as furnace; None refuses such recipes, or repeats
            the ingredient if ``ingredients`` is chain.
        columns: names, or numbers from 1, of the columns of ingredients and, last, of the result;
            None to guess.
        delimiter: column delimiter, a character or comma, semicolon, tab, pipe, space; None to
            guess.
        encoding: encoding of the text; None to guess.
        case: ``keep``, or ``fold`` for labels in lower case.
        ingredients: ``two`` refuses recipes of three and more, ``chain`` makes them chains of
            half-products, see :mod:`~wordcraft_kg.graphs.chains`.

    Raises:
        ConfigError: for a value outside of these.
        RecipeFileError: if ``single_ingredient`` is no label.
    """

    single_ingredient: str | None = None
    columns: Sequence[str] | None = None
    delimiter: str | None = None
    encoding: str | None = None
    case: str = "keep"
    ingredients: str = "two"

    def __post_init__(self) -> None:
        one_of("case", self.case, CASES)
        one_of("ingredients", self.ingredients, INGREDIENTS)
        check_encoding(self.encoding)
        if isinstance(self.columns, str):
            raise ConfigError(f"`columns` {self.columns!r}: expected a list of names or numbers.")
        if self.delimiter is not None:
            delimiter_of(self.delimiter)
        if self.single_ingredient is not None:
            check_label(self.single_ingredient, "`single_ingredient`")
