"""The database: how it is opened, its tables, its one writer, its migrations."""
