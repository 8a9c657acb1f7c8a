"""A model trained by PyKEEN's own pipeline, evaluated as usual and usable by all commands.

Run this script in an empty folder: it writes models/transe, in a few seconds.
"""

import torch
from pykeen.pipeline import pipeline

from wordcraft_kg import from_pykeen, open_graph, open_model, save_scorer
from wordcraft_kg.evaluation.ranked_links import Contender, compare
from wordcraft_kg.models.scorers.baselines import FrequencyScorer


def main() -> None:
    """Train TransE with PyKEEN, make it a model folder, and compare it with counting."""
    torch.set_num_threads(
        1
    )  # on models this small more threads are slower, on a busy machine many times
    opened = open_graph("kitchen")
    result = pipeline(
        dataset="wordcraft",
        dataset_kwargs={"graph": "kitchen"},
        model="TransE",
        epochs=20,
        random_seed=0,
        training_kwargs={"batch_size": 256, "use_tqdm": False},
        evaluation_kwargs={"use_tqdm": False},
    )
    # The dataset's training triples are those of the train recipes.
    save_scorer(
        "models/transe", from_pykeen(result.model, result.training, opened), opened, kg="partial"
    )
    counting = FrequencyScorer(opened.graph, opened.split.partial, name="frequency")
    save_scorer("models/frequency", counting, opened, kg="partial")

    names = ("transe", "frequency")
    comparison = compare([Contender(name, [open_model(f"models/{name}")]) for name in names])
    for model in comparison.models:
        print(
            f"{model.name}: MRR {model.mrr:.3f}, difference {model.difference}, "
            f"{model.difference_ci}"
        )
    print("more: wordcraft-kg evaluate-links models/transe")


if __name__ == "__main__":
    main()
