"""Falls without a bounce: the path of a ball that is dropped, from its release to the end of its track."""
