"""Encounters: an urban road on which all other road users follow a script."""
