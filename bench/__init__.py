"""The operator's desk: the only room that knows all the others."""
