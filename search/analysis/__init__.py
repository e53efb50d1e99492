"""What can be said of an archive: pure functions of archives and plain values."""
