"""What a person looks at while the rig runs: the live page and the terminal view, fed by Zenoh alone."""
