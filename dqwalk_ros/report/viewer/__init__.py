"""A live page in the browser that shows a walk in three dimensions, drawn with viser.

A page shows moments. Their source is a recorded walk (`player.Player`), a walk in another process (`player.Feed`), or
ROS (`dqwalk_ros.nodes.viewer`).
"""
