"""Servers that live as long as a measurement or a test."""
