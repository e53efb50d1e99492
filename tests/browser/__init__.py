"""The dashboard in a real browser: what people see and do, against a real coordinator with a real worker."""
