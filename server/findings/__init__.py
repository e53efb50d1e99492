"""What campaigns found: one folder for each kind of finding, and what all kinds have in common."""
