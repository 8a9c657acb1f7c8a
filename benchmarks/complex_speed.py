"""Time a ComplEx epoch: a plain torch loop, our model inside PyKEEN, and PyKEEN's stock loop.

    python benchmarks/complex_speed.py GRAPH            # a graph folder, a recipe book or a known book's name

All three minimise the same objective (softmax over all heads and over all tails, N3) with the same sizes on a single
CPU thread. The first two alternate, so a busy machine slows both equally; quote ratios.
"""

import argparse
import time

import numpy as np
import torch
from pykeen.losses import CrossEntropyLoss
from pykeen.models import ComplEx
from pykeen.training import SymmetricLCWATrainingLoop
from torch.nn.functional import cross_entropy

from wordcraft_kg.graphs import open_graph
from wordcraft_kg.models.links.builders import make_training_loop
from wordcraft_kg.models.links.config import ComplExConfig
from wordcraft_kg.models.links.pykeen_bridge import pykeen_guard, quiet_pykeen, triples_factory


class PlainTorch:
    """The objective in plain torch: real embeddings, matrix products, Adagrad."""

    def __init__(
        self, triples: torch.Tensor, num_entities: int, num_relations: int, config: ComplExConfig
    ):
        self.triples, self.config = triples, config
        self.entity, self.relation = (
            torch.nn.Parameter(torch.randn(size, 2 * config.dim) * config.init_scale)
            for size in (num_entities, num_relations)
        )
        self.optimizer = torch.optim.Adagrad([self.entity, self.relation], lr=config.learning_rate)

    def epoch(self) -> None:
        dim = self.config.dim
        for batch in self.triples[torch.randperm(len(self.triples))].split(self.config.batch_size):
            head, relation, tail = batch.T
            h, r, t = self.entity[head], self.relation[relation], self.entity[tail]
            (hr, hi), (rr, ri), (tr, ti) = (x.split(dim, dim=1) for x in (h, r, t))
            tails = torch.cat([hr * rr - hi * ri, hr * ri + hi * rr], dim=1) @ self.entity.T
            heads = torch.cat([rr * tr + ri * ti, rr * ti - ri * tr], dim=1) @ self.entity.T
            norms = [
                ((x[:, :dim] ** 2 + x[:, dim:] ** 2).sqrt() ** 3).sum(1).mean() for x in (h, r, t)
            ]
            loss = (
                cross_entropy(tails, tail)
                + cross_entropy(heads, head)
                + self.config.n3 * sum(norms)
            )
            self.optimizer.zero_grad()
            loss.backward()
            self.optimizer.step()


def timed(run, *arguments, **options) -> float:
    start = time.perf_counter()
    run(*arguments, **options)
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("graph", nargs="?", default="kitchen")
    parser.add_argument("--rounds", type=int, default=8, help="epochs of the two fast loops")
    parser.add_argument(
        "--skip-stock", action="store_true", help="leave out PyKEEN's stock loop, which is slow"
    )
    arguments = parser.parse_args()

    opened = open_graph(arguments.graph)
    # The default N3 weight: a training would choose it for a small book.
    config = ComplExConfig().fixed()
    factory = triples_factory(opened.graph, opened.split.partial)
    training = {
        "batch_size": config.batch_size,
        "use_tqdm": False,
        "use_tqdm_batch": False,
        "pin_memory": False,
    }
    with pykeen_guard(config.seed, config.threads), quiet_pykeen():
        plain = PlainTorch(
            factory.mapped_triples, factory.num_entities, factory.num_relations, config
        )
        ours = make_training_loop(config, factory)
        plain.epoch()
        ours.train(factory, num_epochs=1, **training)
        seconds: dict[str, list[float]] = {"plain torch": [], "ours": []}
        for i in range(arguments.rounds):
            seconds["plain torch"].append(timed(plain.epoch))
            seconds["ours"].append(
                timed(ours.train, factory, num_epochs=i + 2, continue_training=True, **training)
            )
        if not arguments.skip_stock:
            model = ComplEx(
                triples_factory=factory,
                embedding_dim=config.dim,
                loss=CrossEntropyLoss(),
                regularizer="powersum",
                regularizer_kwargs={"weight": config.n3 / 2, "p": 3.0, "normalize": False},
                random_seed=config.seed,
            )
            stock = SymmetricLCWATrainingLoop(
                model,
                triples_factory=factory,
                optimizer="Adagrad",
                optimizer_kwargs={"lr": config.learning_rate},
            )
            seconds["PyKEEN stock"] = [timed(stock.train, factory, num_epochs=1, **training)]
    medians = {name: float(np.median(values)) for name, values in seconds.items()}
    print(
        f"{opened.graph.name}: {len(opened.split.partial):,} triples, {config.dim} dims, batch "
        f"{config.batch_size}"
    )
    for name, value in medians.items():
        print(
            f"{name:<13} {value:8.3f} s an epoch   {value / medians['plain torch']:7.2f} x plain "
            "torch"
        )
    if "PyKEEN stock" in medians:
        print(
            f"ours is {medians['PyKEEN stock'] / medians['ours']:.1f} x as fast as the stock loop"
        )


if __name__ == "__main__":
    main()
