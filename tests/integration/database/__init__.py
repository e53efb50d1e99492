"""What depends on the SQL dialect: all of it runs on SQLite and on Postgres."""
