"""Compiled steps under a hash of all they refer to."""
