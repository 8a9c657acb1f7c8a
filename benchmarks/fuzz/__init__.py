"""Bad input by the thousand: whatever a command is given, it answers with an exit code and a
sentence.

Three parts: :mod:`.books` spoils recipe books, :mod:`.artefacts` spoils what the package itself
wrote, :mod:`.values` gives every option of every command odd values. A case is a part's name and a
number, and the number alone decides what is done: ``python -m benchmarks.fuzz --replay artefacts:123``
does it again and shows what the commands said. Two parts call the package and no command:
:mod:`.folders` spoils tensors and records of models and agents, :mod:`.archives` zip and gzip data.

``python -m benchmarks.fuzz --books 10000 --artefacts 5000 --values`` runs many of them.
"""

import os

os.environ.setdefault(
    "OMP_STACKSIZE", "512K"
)  # so that 1,024 threads fit into the memory limit of a command
