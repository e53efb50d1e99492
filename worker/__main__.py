"""Entry point of ``python -m brink.worker``."""

import sys

from brink.worker.run import main

if __name__ == "__main__":
    sys.exit(main())
