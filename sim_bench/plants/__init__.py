"""Plants of the papers: typed parameters, `f` and `h` for a `Model`, energy where the equations have one."""
