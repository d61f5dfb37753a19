"""Everything that keeps what was measured."""
