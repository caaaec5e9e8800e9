"""``python -m bench.figures``."""

import sys

from bench.figures.command import main
from bench.terminal import guarded

if __name__ == "__main__":
    sys.exit(guarded("bench.figures", main))
