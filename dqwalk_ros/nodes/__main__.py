"""``python -m dqwalk_ros.nodes NAME``: run a node."""

import sys

from dqwalk_ros.nodes.command_line import main
from dqwalk_ros.support.node_table import NODES

if len(sys.argv) < 2 or sys.argv[1] not in NODES:
    sys.exit(f"usage: python -m dqwalk_ros.nodes {{{','.join(NODES)}}} ...")
sys.exit(main(sys.argv[1], sys.argv[2:]))
