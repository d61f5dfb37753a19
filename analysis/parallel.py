"""Number of threads of every parallel search: the compiled predictions release the interpreter's lock."""

THREADS = 2
