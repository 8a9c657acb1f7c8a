"""What all model cards begin with."""


def front_matter(*tags: str) -> str:
    """Return the YAML header by which model hubs list a model: the library that loads it, and tags."""
    return "\n".join(["---", "library_name: wordcraft-kg", "tags:", *(f"- {tag}" for tag in tags), "---"])
