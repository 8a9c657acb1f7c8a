"""HTML, JSON and tables from a model or run folder."""
