"""`hil evaluate`: Monte Carlo on the bench, with limits."""
