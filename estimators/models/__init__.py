"""Process models: plain functions that numba compiles, parameters as typed records with units."""
