"""Benchmarks: medians and ratios against a named peer in the same run, as claims."""
