"""Arms beside a walk: they hold a posture, swing with the legs, and follow trajectories and poses of hands."""
