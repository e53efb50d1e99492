"""Episodes as the dashboard draws them: a trace in columns, and the pictures of its film."""
