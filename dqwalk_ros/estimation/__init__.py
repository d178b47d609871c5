"""Estimation for a real robot: prediction over the delay, monitoring of the drive, pose and velocity of the base."""
