"""The life of a job: leases, heartbeats, results, retries."""
