"""``dqwalk view``: shows a recorded walk in the browser."""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path

import click

from dqwalk_ros.cli.options import bag_argument, command, namespace_option, port_option, walk_option


@command("""
examples:
  dqwalk view walk/bag                                     a recorded walk
  dqwalk view walk/bag --open                              and open the browser
  dqwalk simulate --view                                   a walk while it is computed
  dqwalk_viewer                                            a walk on ROS 2, live (or: ros2 run dqwalk_ros viewer)
""")
@bag_argument
@namespace_option
@walk_option
@port_option
@click.option("--open", "open_browser", is_flag=True, help="Open the page in the browser of this machine.")
@click.option("--play", is_flag=True, help="Start playing at once.")
def view(bag: Path, namespace: str | None, walk: str, port: int | None, open_browser: bool, play: bool) -> int:
    """Show a recorded walk in the browser.

    Serves a page on 127.0.0.1 until Ctrl-C: the robot, its soles and support polygon, the planes and cylinders of the
    current phase, the centre of mass and its path, and every margin over time, the smallest one marked. BAG may be
    any bag that `dqwalk report` reads. On another machine, forward the port: ssh -L 8080:127.0.0.1:8080 HOST.
    """
    from dqwalk_ros.report import bag as bags
    from dqwalk_ros.report.viewer.page import Page
    from dqwalk_ros.report.viewer.player import Player

    print(f"reading {bag}", file=sys.stderr)
    content = bags.content_of(bag)  # what is no bag opens no page
    page = Page(port)
    try:
        print(f"{page.url}  (stop with Ctrl-C)", flush=True)
        page.say(f"reading {bag}")
        if open_browser:
            webbrowser.open(page.url)
        trace = bags.read(content, namespace=namespace, walk=walk)
        player = Player(page, trace)
        if play:
            player.toggle()
        for note in trace.notes:
            print(f"note: {note}", file=sys.stderr)
        player.run()
    except KeyboardInterrupt:
        pass
    finally:
        page.close()
    return 0
