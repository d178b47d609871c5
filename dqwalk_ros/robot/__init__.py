"""A robot from its description: links and joints, shapes, soles, servos."""
