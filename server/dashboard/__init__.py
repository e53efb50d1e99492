"""The dashboard: a page of plain ES modules, and what it asks of the coordinator besides the API."""
