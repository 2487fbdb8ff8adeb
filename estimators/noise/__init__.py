"""Noise covariances from the innovations: the likelihood of a window, Sage-Husa's form, the limited one."""
