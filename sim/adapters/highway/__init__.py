"""The simulator `highway-env@1`: a car in highway-env whose perception of other vehicles has errors."""
