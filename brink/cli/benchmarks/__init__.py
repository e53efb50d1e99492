"""The commands of `brink bench`."""
