#!/usr/bin/env bash
# Print the seconds from a clone to an own verified result: bash benchmarks/first_submission.sh [REPOSITORY]
# All files are in a temporary folder; pip may use its cache.
set -euo pipefail
repository="${1:-$(cd "$(dirname "$0")/.." && pwd)}"
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
done_at() { echo "$SECONDS s  $1"; }

SECONDS=0
git clone --quiet "$repository" "$folder/clone"
cd "$folder/clone"
done_at "cloned"
"${PYTHON:-python3}" -m venv .venv
.venv/bin/python -m pip install --quiet --constraint constraints.txt torch
.venv/bin/python -m pip install --quiet --constraint constraints.txt .
done_at "installed"
export PATH="$PWD/.venv/bin:$PATH"
wordcraft-kg bench run craft-8-lite --player "program:python examples/line_player.py" --out submission
done_at "played"
wordcraft-kg bench verify submission
done_at "verified"
