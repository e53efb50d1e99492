"""What ``import brink`` offers: campaigns, results, functions and studies, in the words of command line and REST."""
