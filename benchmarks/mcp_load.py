"""Let many sessions play at once on the MCP server, over HTTP and over standard streams, and measure both sides.

python benchmarks/mcp_load.py --sessions 100 --seconds 10

"http" speaks as clients of protocol versions before 2026-07-28 do, "http-new" as those of that version.

The server is a process of its own. A step is a call of a tool: begin, then combine until the game is over, and again.
Over HTTP each session is a connection; over standard streams, a client has one server, and the sessions are games that
are played at once on it. Times: "work" is processor time of the server per step; "server" is from a request's arrival
in the server to its answer, which with many sessions is mostly waiting for the others; "round trip" is what the client
sees, which works on the same machine. Without a pause between steps the server is always busy; "pause" is the mean of
one as players make it who think. Peak memory is that of the server. Exit code 1 above 5 ms of work or 400 MiB.
"""

import argparse
import asyncio
import json
import os
import random
import re
import signal
import sys
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

MOST_WORK, MOST_MEMORY = 5.0, 400.0
"""Milliseconds a step, and MiB."""
PRESENT = "2026-07-28"
"""The protocol's first version without sessions."""
Call = Callable[[str, dict[str, Any]], Awaitable[dict[str, Any]]]


@dataclass
class Load:
    """What is done to a server, and what was measured of it: seconds of each step."""

    pause: float = 0
    seconds: list[float] = field(default_factory=list)
    at_server: list[float] = field(default_factory=list)


def message(number: int, tool: str, arguments: dict[str, Any], version: str = "") -> bytes:
    """Return a call of a tool; since the protocol's version 2026-07-28, a call says itself of which version it is."""
    params: dict[str, Any] = {"name": tool, "arguments": arguments}
    if version:
        who = {"protocolVersion": version, "clientInfo": {"name": "load", "version": "1"}, "clientCapabilities": {}}
        params["_meta"] = {f"io.modelcontextprotocol/{key}": value for key, value in who.items()}
    return json.dumps({"jsonrpc": "2.0", "id": number, "method": "tools/call", "params": params}).encode()


async def play(call: Call, seed: int, until: float, load: Load) -> None:
    """Play a task after another at random until the time is up, with pauses as long as thoughts are."""
    rng = random.Random(seed)

    async def step(tool: str, **arguments: Any) -> dict[str, Any]:
        await asyncio.sleep(rng.uniform(0, 2 * load.pause))
        began = time.perf_counter()
        answer = await call(tool, arguments)
        load.seconds.append(time.perf_counter() - began)
        if answer["result"].get("isError"):
            raise SystemExit(f"{tool} {arguments}: {answer}")
        values: dict[str, Any] = answer["result"]["structuredContent"]
        return values

    while time.monotonic() < until:
        state = await step("begin", task=rng.randrange(20))
        while not state["is_over"] and time.monotonic() < until:
            one, other = (rng.choice(state["things"]) for _ in range(2))
            state = await step("combine", game=state["game"], first=one, second=other)


# --- transports ------------------------------------------------------------------------------------------------------


async def over_http(address: str, sessions: int, until: float, load: Load, version: str = "") -> None:
    """Let each session play on a connection of its own."""
    found = re.fullmatch(r"http://([^:]+):(\d+)(/.*)", address)
    assert found
    host, port, path = found[1], int(found[2]), found[3]

    async def session(seed: int) -> None:
        reader, writer = await asyncio.open_connection(host, port)

        async def call(tool: str, arguments: dict[str, Any]) -> dict[str, Any]:
            body = message(1, tool, arguments, version)
            names = (
                f"MCP-Protocol-Version: {version}\r\nMcp-Method: tools/call\r\nMcp-Name: {tool}\r\n" if version else ""
            )
            head = (
                f"POST {path} HTTP/1.1\r\nHost: {host}:{port}\r\nContent-Type: application/json\r\n"
                f"{names if version else ''}Accept: application/json, text/event-stream\r\n"
                f"Content-Length: {len(body)}\r\n\r\n"
            )
            writer.write(head.encode() + body)
            headers = (await reader.readuntil(b"\r\n\r\n")).decode().lower()
            size, spent = re.search(r"content-length: (\d+)", headers), re.search(r"dur=([\d.]+)", headers)
            assert size
            assert spent
            load.at_server.append(float(spent[1]) / 1000)
            answer: dict[str, Any] = json.loads(await reader.readexactly(int(size[1])))
            return answer

        await play(call, seed, until, load)
        writer.close()

    await asyncio.gather(*(session(seed) for seed in range(sessions)))


async def shake_hands(server: asyncio.subprocess.Process) -> None:
    """Begin a session on standard streams."""
    reader, writer = server.stdout, server.stdin
    assert reader is not None
    assert writer is not None
    who = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "load", "version": "1"}}
    writer.write(json.dumps({"jsonrpc": "2.0", "id": 0, "method": "initialize", "params": who}).encode() + b"\n")
    await reader.readline()
    writer.write(b'{"jsonrpc": "2.0", "method": "notifications/initialized"}\n')


async def over_stdio(server: asyncio.subprocess.Process, sessions: int, until: float, load: Load) -> None:
    """Let all sessions play at once on one server's standard streams."""
    reader, writer = server.stdout, server.stdin
    assert reader is not None
    assert writer is not None
    waiting: dict[int, asyncio.Future[dict[str, Any]]] = {}
    numbers = iter(range(1, sys.maxsize))

    async def call(tool: str, arguments: dict[str, Any]) -> dict[str, Any]:
        number = next(numbers)
        waiting[number] = asyncio.get_running_loop().create_future()
        writer.write(message(number, tool, arguments) + b"\n")
        return await waiting[number]

    async def listen() -> None:
        while line := await reader.readline():
            answer = json.loads(line)
            if answer.get("id") in waiting:
                waiting.pop(answer["id"]).set_result(answer)

    listening = asyncio.create_task(listen())
    await asyncio.gather(*(play(call, seed, until, load) for seed in range(sessions)))
    listening.cancel()


# --- measuring -------------------------------------------------------------------------------------------------------


def processor_seconds(process: int) -> float:
    """Return the processor time that a process has used."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def peak_memory(process: int) -> float:
    """Return the most MiB that a process has had in memory."""
    found = re.search(r"VmHWM:\s+(\d+)", Path(f"/proc/{process}/status").read_text())
    assert found
    return int(found[1]) / 1024


def percentiles(seconds: list[float]) -> list[str]:
    """Return milliseconds: median, 95 %, 99 %."""
    ordered = sorted(seconds)
    return [f"{1000 * ordered[len(ordered) * share // 100]:.1f}" for share in (50, 95, 99)] if ordered else ["-"] * 3


async def measured(
    transport: str, command: list[str], sessions: int, seconds: float, pause: float
) -> tuple[list[str], float, float]:
    """Start a server, load it, and return a row of the table, the work of a step in ms and the memory in MiB."""
    options = [] if transport == "stdio" else ["--transport", "http", "--port", "0", "--json"]
    pipe = asyncio.subprocess.PIPE
    server = await asyncio.create_subprocess_exec(*command, *options, stdin=pipe, stdout=pipe, limit=2**24)
    assert server.stdout is not None
    load = Load()
    if transport != "stdio":
        address = json.loads(await server.stdout.readline())["address"]
    else:
        await shake_hands(server)

    async def loaded(until: float) -> None:
        if transport == "stdio":
            await over_stdio(server, sessions, until, load)
        else:
            await over_http(address, sessions, until, load, PRESENT if transport == "http-new" else "")

    await loaded(time.monotonic() + 1)  # what is made once is made now
    load = Load(pause)
    before, began = processor_seconds(server.pid), time.monotonic()
    await loaded(began + seconds)
    spent, work = time.monotonic() - began, processor_seconds(server.pid) - before
    memory, steps = peak_memory(server.pid), len(load.seconds)
    server.send_signal(signal.SIGINT)
    await server.communicate()
    each = 1000 * work / steps
    row = [transport, f"{sessions}", f"{pause:g}", f"{steps / spent:,.0f}", f"{each:.2f}", *percentiles(load.at_server)]
    return [*row, *percentiles(load.seconds), f"{memory:.0f}"], each, memory


def main() -> int:
    """Measure, print a table, and return 1 if a limit is exceeded."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--graph", default="everyday")
    parser.add_argument("--sessions", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=10)
    parser.add_argument("--pause", type=float, default=2, help="seconds that a player thinks, 2.4 at most")
    parser.add_argument("--attempts", default="20")
    parser.add_argument("--options", default="", help="further options of the command, such as '--knowledge partial'")
    arguments = parser.parse_args()
    options = ["--attempts", arguments.attempts, *arguments.options.split()]
    command = [sys.executable, "-m", "wordcraft_kg", "mcp", arguments.graph, *options]
    times = [f"{where} {kind}" for where in ("server", "trip") for kind in ("p50", "p95", "p99")]
    rows = [["", "sessions", "pause", "steps/s", "work ms", *times, "MiB"]]
    is_over = False
    for transport in ("http", "http-new", "stdio"):
        for sessions, pause in ((1, 0.0), (arguments.sessions, 0.0), (arguments.sessions, arguments.pause)):
            row, work, memory = asyncio.run(measured(transport, command, sessions, arguments.seconds, pause))
            rows.append(row)
            is_over |= work > MOST_WORK or memory > MOST_MEMORY
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print("  ".join(f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)))
    return int(is_over)


if __name__ == "__main__":
    sys.exit(main())
