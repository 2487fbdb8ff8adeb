"""Fault injection: scenario files, and what their faults do to frames, sensors, valve, cylinder, bus and operator."""
