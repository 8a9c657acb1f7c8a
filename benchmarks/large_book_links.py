"""ComplEx on large books: cost and quality for sampled softmax, full softmax and counting.

    python benchmarks/large_book_links.py speed --entities 100000 --recipes 1000000 --batches 300
    python benchmarks/large_book_links.py quality GRAPH --epochs 5 --negatives 512 0

`speed` times some batches on a synthetic book and extrapolates to an epoch, in CPU seconds on a
single thread, which do not depend on machine load. `quality` trains on a folder's partial graph and
ranks a sample of unseen triples.
"""

import argparse
import resource
import time

import torch
from pykeen.triples import CoreTriplesFactory
from synthetic_book import synthetic_rows

from wordcraft_kg.graphs import open_graph
from wordcraft_kg.graphs.triples import RELATIONS, recipe_triples
from wordcraft_kg.models.links.builders import make_training_loop, scorer_tensors
from wordcraft_kg.models.links.config import ComplExConfig
from wordcraft_kg.models.links.fitting import fit
from wordcraft_kg.models.links.pykeen_bridge import pykeen_guard, quiet_pykeen, triples_factory
from wordcraft_kg.models.scorers.baselines import FrequencyScorer
from wordcraft_kg.models.scorers.folder import make_scorer
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples, sampled


def peak() -> str:
    return f"peak {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB"


def speed(entities: int, recipes: int, batches: int, config: ComplExConfig) -> None:
    train = synthetic_rows(entities, recipes, base=10, seed=0)[: recipes * 8 // 10]
    triples = torch.from_numpy(recipe_triples(train))
    factory = CoreTriplesFactory(triples, num_entities=entities, num_relations=len(RELATIONS))
    some = factory.clone_and_exchange_triples(
        triples[torch.randperm(len(triples))[: batches * config.batch_size]]
    )
    options = {
        "batch_size": config.batch_size,
        "use_tqdm": False,
        "use_tqdm_batch": False,
        "pin_memory": False,
    }
    with pykeen_guard(config.seed, config.threads), quiet_pykeen():
        loop = make_training_loop(config, factory)
        loop.train(some, num_epochs=1, **options)
        begun = time.process_time()
        loop.train(some, num_epochs=2, continue_training=True, **options)
        seconds = time.process_time() - begun
    whole = seconds * len(triples) / len(some.mapped_triples)
    each = f"{1e3 * seconds / batches:.1f} ms a batch, {whole:.0f} s an epoch"
    print(f"{entities:,} entities, {len(triples):,} triples: {each}, {peak()}")


def quality(graph: str, negatives: list[int], queries: int, config: dict[str, int]) -> None:
    opened = open_graph(graph)
    known, train = opened.graph.triples, opened.split.partial
    asked = sampled(opened.split.held_out("test"), queries // 2)

    def mrr(scorer) -> float:
        return mean_reciprocal_rank(rank_triples(scorer, asked, known))

    print(
        f"{opened.graph.name}: {opened.graph.num_entities:,} entities, {len(train):,} training "
        "triples",
        flush=True,
    )
    print(f"frequency       MRR {mrr(FrequencyScorer(opened.graph, train)):.4f}", flush=True)
    for number in negatives:
        settings = ComplExConfig(negatives=number, **config)
        factory = triples_factory(opened.graph, train)
        begun = time.process_time()
        model = fit(settings, factory, lambda epoch: None)
        seconds = (time.process_time() - begun) / settings.epochs
        scorer = make_scorer(
            *scorer_tensors(settings, model, train), opened.graph.entities, opened.graph.hash
        )
        name = f"{number:,} sampled" if number else "all entities"
        print(
            f"{name:<15} MRR {mrr(scorer):.4f}, {seconds:.1f} CPU s an epoch, {peak()}", flush=True
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    one, other = commands.add_parser("speed"), commands.add_parser("quality")
    one.add_argument("--entities", type=int, default=100_000)
    one.add_argument("--recipes", type=int, default=1_000_000)
    one.add_argument("--batches", type=int, default=300)
    one.add_argument("--negatives", type=int, default=None)
    other.add_argument("graph")
    other.add_argument("--epochs", type=int, default=5)
    other.add_argument("--negatives", type=int, nargs="+", default=[512, 0])
    other.add_argument("--queries", type=int, default=5_000)
    for command in (one, other):
        command.add_argument("--dim", type=int, default=ComplExConfig.dim)
        command.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    if arguments.command == "speed":
        config = ComplExConfig(
            dim=arguments.dim, threads=arguments.threads, negatives=arguments.negatives
        )
        speed(arguments.entities, arguments.recipes, arguments.batches, config)
    else:
        config = {"dim": arguments.dim, "threads": arguments.threads, "epochs": arguments.epochs}
        quality(arguments.graph, arguments.negatives, arguments.queries, config)


if __name__ == "__main__":
    main()
