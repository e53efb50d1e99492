"""Stateless workers: wire messages, HTTP client, and the loop that leases, simulates and reports."""
