"""Options of a drop test that every stage heeds: corrections by hand, and what is told while it runs."""
