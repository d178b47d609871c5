"""The dynamic walk, which plans the divergent component of motion over footprints; not in Urban and Adorno's paper."""
