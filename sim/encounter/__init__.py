"""Encounters: an urban road on which every other road user follows a script."""
