"""The Python API: campaigns, results, functions and studies, in the words of the command line and REST."""
