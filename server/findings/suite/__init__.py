"""Findings of the kind `suite`: what has become of drives that were found earlier."""
