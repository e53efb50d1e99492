"""The REST API: routes parse, call one service function, return a schema."""
