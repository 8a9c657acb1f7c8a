#!/usr/bin/env bash
# Train the scorers and agents of the leaderboard in a folder, and let each play again: `bench verify` says "reproduced" if
# weights and games are those of the submission. About 20 minutes of CPU time.
#
#     bash benchmarks/leaderboard_models.sh FOLDER
set -euo pipefail
out="$1" rows=leaderboard/everyday-v2

check() { # PLAYER ROW...
  local player="$1"
  shift
  local files=("${@/#/$rows/}")
  wordcraft-kg bench verify "${files[@]/%/.zip}" --player "$player" || true
}

wordcraft-kg build-graph everyday --out "$out/by-recipe"
wordcraft-kg build-graph everyday --split by-goal --out "$out/by-goal"
for words in glove minilm; do
  for split in by-recipe by-goal; do
    wordcraft-kg train-recipes "$out/$split" --features "$words" --out "$out/$words-$split"
  done
  check "scorer:$out/$words-by-recipe" {craft-8,craft-1,depth-2,discover-500}-lite/scorer-$words
  check "scorer:$out/$words-by-goal" goal-8-lite/scorer-$words
  check "planner:$out/$words-by-recipe" {craft-8,craft-1,depth-2}-lite/planner-$words
  check "planner:$out/$words-by-goal" goal-8-lite/planner-$words
done

wordcraft-kg train-complex "$out/by-goal" --folds 0 --out "$out/complex-by-goal"
check "scorer:$out/complex-by-goal" goal-8-lite/complex

train() { # NAME SPLIT OPTIONS...
  local name="$1" split="$2"
  shift 2
  wordcraft-kg train-agent "$out/$split" --out "$out/$name" --eval-every 0 "$@"
}

deep=(--depth 2 --distractors 4 --steps 150000 --scorer-cost 0)
scores=(--scorer "$out/glove-by-recipe")
train uvw by-recipe "${scores[@]}" --use u,v,w --steps 300000
train uvw-goal by-goal --scorer "$out/glove-by-goal" --use u,v,w --steps 300000
train uvwp by-recipe "${deep[@]}" "${scores[@]}" --use u,v,w,p
train uvw-deep by-recipe "${deep[@]}" "${scores[@]}" --use u,v,w
train uv-deep by-recipe "${deep[@]}" "${scores[@]}" --use u,v
train none-deep by-recipe "${deep[@]}"
check "agent:$out/uvw" {craft-8,craft-1}-lite/agent-uvw
check "agent:$out/uvw-goal" goal-8-lite/agent-uvw
check "agent:$out/uvwp" depth-2-lite/agent-uvwp
check "agent:$out/uvw-deep" depth-2-lite/agent-uvw
check "agent:$out/uv-deep" depth-2-lite/agent-uv
check "agent:$out/none-deep" depth-2-lite/agent-no-graph
