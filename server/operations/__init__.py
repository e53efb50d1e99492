"""Tools for operators: diagnosis, retention, export and import of campaigns."""
