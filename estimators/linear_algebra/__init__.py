"""QR, triangular solves, rank-one updates, views."""
