"""What kinds of violations there are: rules that make types of the circumstances that a simulator reports."""
