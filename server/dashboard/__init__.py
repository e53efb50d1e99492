"""The dashboard: a page of plain ES modules, and the figures computed for it."""
