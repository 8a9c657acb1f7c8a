"""Graph folders of built-in books."""

from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split, open_book, write_graph_folder


def write_graph(folder, book="kitchen", **split):
    """Write a book's graph folder, with a split of these settings; one that exists is replaced."""
    recipes = open_book(book)
    write_graph_folder(
        folder,
        recipes,
        make_split(RecipeGraph.from_book(recipes), SplitConfig(**split)),
        force=True,
    )
    return folder
