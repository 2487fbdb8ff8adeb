"""Derivatives of the whole filter, and parameters moved along them (P4)."""
