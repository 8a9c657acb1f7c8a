"""Showing how far a training is."""

from collections.abc import Iterator
from contextlib import contextmanager

from wordcraft_kg.runs.folder import Progress

TOLD_BY_THE_BAR = ("epoch", "seconds", "steps_per_second")


@contextmanager
def shown(progress: Progress | bool | None, what: str, unit: str) -> Iterator[Progress | None]:
    """Yield what reports progress: the caller's own function, a bar in a terminal or notebook for True, or None.

    Args:
        progress: as it was asked for.
        what: name of what is trained.
        unit: what is counted: epoch or step.
    """
    if not isinstance(progress, bool):
        yield progress
        return
    if not progress:
        yield None
        return
    from tqdm.auto import tqdm

    with tqdm(desc=what, unit=unit, unit_scale=unit == "step") as bar:

        def show(done: int, total: int, figures: dict[str, float]) -> None:
            bar.total = total
            told = {name: f"{value:.4g}" for name, value in figures.items() if name not in TOLD_BY_THE_BAR}
            bar.set_postfix(told, refresh=False)
            bar.update(done - bar.n)

        yield show
