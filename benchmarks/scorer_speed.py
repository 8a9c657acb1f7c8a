"""Time what a user waits for: help, loading a scorer, looking triples up, a graph's reachability.

python benchmarks/scorer_speed.py MODEL_FOLDER
"""

import argparse
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import torch

from wordcraft_kg.models.scorers.folder import load_scorer


def median_ms(run, times: int = 15) -> float:
    seconds = []
    for _ in range(times):
        start = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - start)
    return 1_000 * float(np.median(seconds))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path)
    folder = parser.parse_args().model
    torch.set_num_threads(1)
    command = [sys.executable, "-m", "wordcraft_kg", "--help"]
    print(
        "--help                       "
        f"{median_ms(lambda: subprocess.run(command, capture_output=True), 5):8.1f} ms"
    )
    start = time.perf_counter()
    scorer = load_scorer(folder)
    print(f"load a scorer, first time    {1_000 * (time.perf_counter() - start):8.1f} ms")
    print(f"load a scorer, again         {median_ms(lambda: load_scorer(folder)):8.1f} ms")
    ids = torch.randint(
        len(scorer.entities), (2, 100_000), generator=torch.Generator().manual_seed(0)
    )
    relations = torch.arange(100_000) % 2
    print(
        "look up 100,000 triples      "
        f"{median_ms(lambda: scorer.score(ids[0], relations, ids[1])):8.1f} ms"
    )


if __name__ == "__main__":
    main()
