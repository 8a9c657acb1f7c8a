"""Products on top of the core: none is imported by the core, and none imports another."""
