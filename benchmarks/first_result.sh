#!/usr/bin/env bash
# Print seconds and size from a clone to a first honest result: bash benchmarks/first_result.sh [PIP OPTIONS FOR TORCH]
# As the guide: the CPU build of torch first, then the package, then the four commands of the README. Fails above 300 s or
# 1,700 MB. All files are in a temporary folder; pip may use its cache. On Linux, the CPU build needs the option
# --index-url of docs/installation.md, unless pip's settings name another place with this build.
set -euo pipefail
unset PYTHONPATH PYTHONDONTWRITEBYTECODE
repository="${REPOSITORY:-$(cd "$(dirname "$0")/.." && pwd)}"
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
done_at() { printf '%4d s  %5d MB  %s\n' "$SECONDS" "$(du -sm "$folder" | cut -f1)" "$1"; }

SECONDS=0
git clone --quiet --depth 1 "file://$repository" "$folder/clone"
cd "$folder/clone"
done_at "cloned"
"${PYTHON:-python3}" -m venv .venv
# A place named in the options may lack the pinned versions of torch's requirements.
[ $# -gt 0 ] || set -- --constraint constraints.txt
.venv/bin/python -m pip install --quiet --no-compile "$(grep -o '^torch==[0-9.]*' constraints.txt)" "$@"
done_at "torch installed"
.venv/bin/python -m pip install --quiet --no-compile --constraint constraints.txt .
done_at "wordcraft-kg installed"
export PATH="$PWD/.venv/bin:$PATH" XDG_CACHE_HOME="$folder/cache" PYSTOW_HOME="$folder/pystow"
wordcraft-kg doctor
wordcraft-kg build-graph kitchen --out graphs/kitchen
wordcraft-kg train-recipes graphs/kitchen --out models/kitchen
wordcraft-kg score models/kitchen cheese + tomato --top 2
wordcraft-kg evaluate-links models/kitchen
done_at "links of test recipes ranked, against baselines"
wordcraft-kg bench run craft-8-lite --player nearest-words --out submission
wordcraft-kg bench verify submission
done_at "a track of the benchmark played, and verified by replay"

times >"$folder/times"
echo "CPU, user and system: $(tail -n 1 "$folder/times"); load: $(cut -d' ' -f1-3 /proc/loadavg 2>/dev/null || true)"
size="$(du -sm "$folder" | cut -f1)"
if [ "$SECONDS" -gt 300 ] || [ "$size" -gt 1700 ]; then
  echo "above 300 s or 1,700 MB" >&2
  exit 1
fi
