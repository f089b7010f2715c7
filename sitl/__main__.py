"""``python -m sitl``: the same as the console script."""

import sys

from sitl.cli import main

sys.exit(main())
