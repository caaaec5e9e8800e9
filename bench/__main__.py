"""Entry point of ``python -m bench``; worker processes import it too, so it imports nothing else."""

import sys

if __name__ == "__main__":
    from bench.commands.main import main

    sys.exit(main())
