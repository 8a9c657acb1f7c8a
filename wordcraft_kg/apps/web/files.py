"""The style sheet for all pages, and the static files of an application."""

from collections.abc import Awaitable, Callable, Collection
from importlib.resources import files

from starlette.requests import Request
from starlette.responses import Response

from wordcraft_kg.reports.pages import make_environment


def style_sheet() -> str:
    """Return the style sheet for reports, extended for sites."""
    environment = make_environment("wordcraft_kg.apps.web", "wordcraft_kg.reports")
    return environment.get_template("explorer.css.j2").render()


def static_texts(package: str, names: Collection[str]) -> dict[str, str]:
    """Return texts from the folder ``static`` of a package, by name."""
    folder = files(package) / "static"
    return {name: (folder / name).read_text(encoding="utf-8") for name in names}


def file_endpoint(
    package: str, names: Collection[str], missing: Callable[[str], Response]
) -> Callable[[Request], Awaitable[Response]]:
    """Return the endpoint for ``/files/{name}``: the style sheet and static files.

    The files are read once. A name is only a key among them, never a path, so no other file of the
    machine can be asked for.

    Args:
        package: package with the folder ``static``.
        names: names of the static files.
        missing: returns the answer for another name, from a message.
    """
    texts = {"explorer.css": style_sheet(), **static_texts(package, names)}

    async def file(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in texts:
            return missing(f"The file '{name[:60]}' does not exist.")
        kind = "text/css" if name.endswith(".css") else "text/javascript"
        # no-cache lets browsers keep a file, but ask each time: another version has other files.
        return Response(texts[name], media_type=kind, headers={"Cache-Control": "no-cache"})

    return file
