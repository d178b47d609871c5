"""The report of a walk as one self-contained HTML file: verdict, replay, figures, tables.

`page` writes the report of a walk of phases, or of two side by side, `body` that of a whole-body walk. The file opens
offline; `replay.js` draws the replay with WebGL from the shapes and the poses of the bodies of the robot.
"""
