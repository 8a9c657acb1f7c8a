"""``python -m wordcraft_kg``."""

import sys

from wordcraft_kg.cli import main

sys.exit(main())
