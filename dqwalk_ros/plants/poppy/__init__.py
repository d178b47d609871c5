"""The servos of Poppy Humanoid."""
