"""What the servos of a robot do: an exercise that shows it, the fit that finds it, the replay that checks it."""
