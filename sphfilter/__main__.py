"""``python -m sphfilter`` is the command ``sphfilter``."""

import sys

from .command.main import main

if __name__ == "__main__":
    sys.exit(main())
