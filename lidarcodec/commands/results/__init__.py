"""What each command prints with `--json`: types whose fields have a text. docs/json.md is written from them."""
