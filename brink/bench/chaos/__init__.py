"""A campaign while everything around it breaks: processes, connections, messages, clocks."""
