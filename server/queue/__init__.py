"""The job queue: leases, heartbeats, results, retries."""
