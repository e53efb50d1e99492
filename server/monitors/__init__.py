"""Safety monitors of campaigns, and how well they foretell what was never searched."""
