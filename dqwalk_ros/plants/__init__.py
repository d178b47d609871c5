"""What executes the commands: an integrator, a physics engine, a Poppy."""
