"""Identification of servo parameters: an exercise, the fit of a servo model, and a replay that validates the model."""
