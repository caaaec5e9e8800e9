"""``python -m bench``; kept to one import so that worker processes, which import it too, start fast."""

import sys

if __name__ == "__main__":
    from bench.commands.main import main

    sys.exit(main())
