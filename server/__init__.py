"""The coordinator: FastAPI app, database, queue, campaigns, command line."""
