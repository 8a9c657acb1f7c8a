"""Concurrent sessions on `wordcraft-kg serve openenv`, with OpenEnv's own client.

Run it in an environment with the package openenv (0.10.0 was measured), against a server on the
same machine or another. Each session plays games by drawn answers; a game is lost if it ends
otherwise than a game that is played again alone. Other processes with open games are killed
meanwhile.

    wordcraft-kg serve openenv everyday --depth 1,2 --port 8000
    python benchmarks/openenv_sessions.py http://127.0.0.1:8000 --sessions 200 --games 20
"""

import argparse
import asyncio
import json
import random
import signal
import subprocess
import sys
import time

from openenv import GenericEnvClient


async def play(env, game, trail):
    """Play a game by a generator of its own; note all observations."""
    rng = random.Random(game)
    result = await env.reset(split="train", index=game)
    trail.append((result.observation, result.done))
    while not result.done:
        size = len(result.observation["table"])
        result = await env.step({"answer": f"{rng.randint(1, size)} + {rng.randint(1, size)}"})
        trail.append((result.observation, result.reward, result.done))


async def session(base, games):
    trails = {}
    async with GenericEnvClient(base_url=base) as env:
        for game in games:
            await play(env, game, trails.setdefault(game, []))
    return trails


async def hang(base, number):
    """Open sessions in the middle of a game, and keep them until this process is killed."""
    clients = [GenericEnvClient(base_url=base) for _ in range(number)]
    for client in clients:
        await client.connect()
        await client.reset(seed=1)
    print("open", flush=True)
    await asyncio.sleep(600)


def start_victims(base, number):
    command = [sys.executable, __file__, base, "--hang", str(number)]
    victim = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert victim.stdout.readline() == "open\n"
    return victim


async def main(options):
    base = options.address
    victims = [start_victims(base, 10) for _ in range(options.killed)]
    games = {
        number: range(number * options.games, (number + 1) * options.games)
        for number in range(options.sessions)
    }
    begin = time.perf_counter()
    running = [asyncio.create_task(session(base, own)) for own in games.values()]
    await asyncio.sleep(1)
    for victim in victims:
        victim.send_signal(signal.SIGKILL)
    results = await asyncio.gather(*running, return_exceptions=True)
    seconds = time.perf_counter() - begin
    broken = [one for one in results if isinstance(one, BaseException)]
    played = {}
    for one in results:
        if not isinstance(one, BaseException):
            played |= one
    alone = await session(base, random.Random(0).sample(sorted(played), min(500, len(played))))
    differing = [game for game, trail in alone.items() if trail != played[game]]
    lost = options.sessions * options.games - len(played) + len(differing)
    figures = {
        "sessions": options.sessions,
        "games": len(played),
        "lost": lost,
        "broken sessions": len(broken),
        "played again alone": len(alone),
        "killed processes": options.killed,
        "seconds": round(seconds, 1),
        "games a second": round(len(played) / seconds),
    }
    print(json.dumps(figures))
    return 1 if lost or broken else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("address")
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--games", type=int, default=20)
    parser.add_argument("--killed", type=int, default=3, help="processes of ten sessions each")
    parser.add_argument("--hang", type=int, default=0, help=argparse.SUPPRESS)
    given = parser.parse_args()
    sys.exit(asyncio.run(hang(given.address, given.hang) if given.hang else main(given)))
