"""The papers' experiments, one declaration each, and what it takes to repeat them."""
