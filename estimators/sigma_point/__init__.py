"""Sigma points and the compiled steps of the filters that use them."""
