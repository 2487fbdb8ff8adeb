"""Control laws: from the tracking error and the plant's f and b to a command."""
