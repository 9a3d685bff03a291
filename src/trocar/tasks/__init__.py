"""Tasks: one package each, registered by an entry point (``pyproject.toml``)."""
