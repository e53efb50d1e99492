"""Stateless workers: wire messages, HTTP client, the loop that leases, simulates, reports."""
