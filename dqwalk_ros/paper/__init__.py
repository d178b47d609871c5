"""Urban and Adorno, in this order: dual_quaternions geometry kinematics features constraints tasks assembly qp walk.

Not in the paper: `collisions` (distances between parts that both move), `statics` (torques against gravity).
"""
