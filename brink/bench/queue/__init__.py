"""How many jobs a second the queue hands out and takes back, beside Celery and procrastinate."""
