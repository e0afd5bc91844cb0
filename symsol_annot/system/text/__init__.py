"""Text from files: names, Markdown, TOML."""
