"""The database: engines, tables, shared SQL, the writer thread, migrations."""
