"""Urban and Adorno, in this order: dual_quaternions geometry kinematics constraints tasks assembly qp walk."""
