"""The server of a Space: `wordcraft-kg serve openenv` on all addresses."""

import os
import sys


def main() -> None:
    """Serve the train tasks; names of a proxy come from SPACE_HOST."""
    command = [sys.executable, "-m", "wordcraft_kg", "serve", "openenv", "everyday"]
    command += ["--host", "0.0.0.0", "--port", "8000"]
    host = os.environ.get("SPACE_HOST")
    if host:
        command += ["--allow-host", host]
    # In place of this process, so that the container's signals reach the server.
    os.execv(sys.executable, command)


if __name__ == "__main__":
    main()
