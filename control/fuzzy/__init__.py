"""Fuzzy systems of the control laws: interval type-2 with exact type reduction, and their type-1 twins."""
