"""Experiments: methods compared on problems over several seeds, one campaign each."""
