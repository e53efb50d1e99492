"""The REST API. Each route parses its request, calls one service function, and returns a response schema."""
