"""``python -m worker``."""

import sys

from worker.run import main

if __name__ == "__main__":
    sys.exit(main())
