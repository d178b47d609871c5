"""``python -m dqwalk_ros.cli``."""

import sys

from dqwalk_ros.cli import main

if __name__ == "__main__":
    sys.exit(main())
