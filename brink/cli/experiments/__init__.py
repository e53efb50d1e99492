"""`brink experiment`: several methods with several seeds, compared."""
