"""Alembic migrations, packaged so that an installed Brink can upgrade its database."""
