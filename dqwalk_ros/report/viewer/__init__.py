"""The page people look at: a walk in three dimensions, in the browser [viser].

A page shows moments. They come from a recorded walk (`player.Player`), from a walk in another process (`player.Feed`),
or from ROS (`dqwalk_ros.nodes.viewer`).
"""
