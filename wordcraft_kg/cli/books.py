"""``wordcraft-kg books``."""

from wordcraft_kg.cli.console import Output

EXAMPLES = ("wordcraft-kg books", "wordcraft-kg books --json")


def books(*, output: Output = Output()) -> None:
    """List the recipe books known by name: built in, in the cache or data folder, and to fetch.

    A book's name works wherever a recipe book's path does.
    """
    from wordcraft_kg.graphs.library import DATA_VARIABLE, FETCHABLE, cache_folder, data_folder, known_books

    found = [
        {
            "name": book.name,
            "origin": book.origin,
            "path": None if book.path is None else str(book.path),
            "note": FETCHABLE[book.name].note if book.name in FETCHABLE else "",
        }
        for book in known_books()
    ]
    width = max(len(str(book["name"])) for book in found)
    lines = [
        f"{book['name']:<{width}}  {book['origin']:<11}  "
        + (str(book["path"] or f"get it: wordcraft-kg fetch {book['name']}") if book["origin"] != "built in" else "")
        + (f"  ({book['note']})" if book["note"] else "")
        for book in found
    ]
    folder = data_folder()
    lines.append(f"your own: any path, or files in the folder that {DATA_VARIABLE} names ({folder or 'not set'})")
    values = {"books": found, "cache": str(cache_folder()), "data_folder": None if folder is None else str(folder)}
    output.result(values, (line.rstrip() for line in lines))
