"""Sequential tests for a shift of the mean of a residual, with thresholds derived from a stated false-alarm rate."""
