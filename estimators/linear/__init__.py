"""Compiled steps of the linear and linearised filters."""
