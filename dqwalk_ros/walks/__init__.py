"""Walks beyond the paper's: standing on the true soles, and dynamic."""
