"""Jobs: what a command does, as a typed object of settings with `run()`, the same from a notebook."""
