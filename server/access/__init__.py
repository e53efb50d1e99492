"""Access control: bearer tokens with scopes, and rate limits."""
