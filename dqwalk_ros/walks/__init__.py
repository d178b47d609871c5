"""Walks beyond the paper's: standing on the real soles, and dynamic."""
