"""Doors: who may read and who may command over the network. Certificates of our own, and what each name is allowed."""
