"""The walk that moves: the divergent component of motion planned over footprints; not in Urban and Adorno's paper."""
