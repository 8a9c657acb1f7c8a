"""Work that nodes of a test's cluster import: it takes its time, and leaves notes."""

import json
import os
import signal
import time

from wordcraft_kg.studies.tasks import Outcome


def play(task, root):
    """Pretend to be a training, as `how` of the settings says; write `made` when it is done."""
    import ray

    folder = task.folder(root)
    folder.mkdir(parents=True, exist_ok=True)
    note = {
        "task": task.address,
        "node": ray.get_runtime_context().get_node_id(),
        "threads": os.environ["OMP_NUM_THREADS"],
    }
    with (root / "notes").open("a") as notes:
        notes.write(json.dumps(note) + "\n")
    how = task.settings["how"]
    if how == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    if how == "full":
        return Outcome(task.address, "failed", "no space", disk_full=True)
    asked = []
    signal.signal(signal.SIGINT, lambda *_: asked.append(1))
    for _ in range(int(10 * task.settings["seconds"])):
        time.sleep(0.1)
        if asked:
            (folder / "checkpoint").touch()
            return Outcome(task.address, "interrupted")
    with (folder / "made").open("a") as made:
        made.write("once\n")
    return Outcome(task.address, "done")
