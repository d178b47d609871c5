"""Errors, texts, compilation and other helpers that know nothing of robots."""
