"""One file per command; heavy imports stay inside the functions so that `bench --help` is instant."""
