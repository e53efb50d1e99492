"""Tools for operators: diagnosis, retention, and export and import of campaigns."""
