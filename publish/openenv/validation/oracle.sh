#!/bin/sh
# Plays task 0 of the part train, table 0, by its recipe; prints the reward.
python - <<'EOF'
import json
from websockets.sync.client import connect
with connect("ws://127.0.0.1:8000/ws") as socket:
    for kind, data in (("reset", {"split": "train", "index": 0, "seed": 0}), ("step", {"answer": "accountant + wood"})):
        socket.send(json.dumps({"type": kind, "data": data}))
        reply = json.loads(socket.recv())["data"]
print(reply["reward"])
EOF
