"""Truncated Taylor series through a user's model."""
